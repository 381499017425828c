"""Messages of other programs: bags of ROS 2 and 1 and foreign MCAP files, whatever their topics are called."""
