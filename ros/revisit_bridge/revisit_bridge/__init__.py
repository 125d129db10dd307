"""Revisit for ROS 2: clouds and odometry to the service, loop closures and the map's frame back.

The modules in the order in which a cloud passes them; `node` and `lifecycle_node` alone import rclpy:
parameters -> messages -> pairing -> session_rule -> outbox -> answers -> publishing -> bridge -> node.
"""
