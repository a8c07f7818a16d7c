"""A sensor of somebody else's: publishes points, 16 bytes each, on a topic until it is ended.

`python topic_publisher.py TOPIC HZ POINTS`, in the domain of ROS_DOMAIN_ID.
"""

import sys
import time

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2


def main() -> None:
    topic, rate_hz, points = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("lidar")
    publisher = node.create_publisher(PointCloud2, topic, qos_profile_sensor_data)
    message = PointCloud2(width=points, height=1, point_step=16, row_step=16 * points)
    message.header.frame_id = "lidar_link"
    message.data = bytes(16 * points)
    while True:
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
        time.sleep(1 / rate_hz)


if __name__ == "__main__":
    main()
