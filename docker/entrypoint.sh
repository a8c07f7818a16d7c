#!/bin/bash
# Run the given command in ROS 2's environment. No `-u`: ROS's own script uses unset variables.
set -eo pipefail
. "/opt/ros/${ROS_DISTRO}/setup.bash"
exec "$@"
