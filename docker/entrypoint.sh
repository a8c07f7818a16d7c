#!/bin/bash
# Become the given command with ROS 2's environment. `-u` would stumble over ROS's own script.
set -eo pipefail
. "/opt/ros/${ROS_DISTRO}/setup.bash"
exec "$@"
