"""ROS without ROS: messages of a scenario's state, and bags of them."""
