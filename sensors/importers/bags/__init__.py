"""Bags: ROS 1 and 2, and what cameras' SDKs record in their container."""
