"""Messages of other programs: bags of ROS 2 and foreign MCAP files, whatever their topics are called."""
