"""The ROS graph: the only room that imports rclpy."""
