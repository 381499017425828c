"""Messages of other programs: bags of ROS 1 and 2, and external MCAP files."""
