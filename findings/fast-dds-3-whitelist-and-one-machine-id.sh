#!/bin/bash
# Fast DDS 3: with an interface whitelist, two devices that have one /etc/machine-id never meet
#
# version:  Fast DDS 3.2.3 below rclpy 9.1.2 of ROS 2 Kilted (Python wheels, Linux, x86_64)
# expected: two nodes on two devices, each with a profile whose UDP transport is bound to the address that joins them, meet
# seen:     they meet where /etc/machine-id differs. Where it is the same, as on two boards that were written from one image,
#           they never do: announcements arrive by multicast, and the other's addresses, taken for this device's own, are none
#           that the whitelist allows. Without a whitelist they meet. Fast DDS 2.14.5 does not compare these files
# source:   https://github.com/eProsima/Fast-DDS/issues/4879 (open, of host ids that are alike by chance);
#           https://github.com/eProsima/Fast-DDS/issues/5382 (the machine id that Fast DDS 3 announces)
#
# Two network namespaces with one veth pair are the devices. Needs what `unshare -rnm` needs, Python 3.11 and iproute2.
# Exits with 0 while it is so, with 1 once they meet, with 2 where it cannot be tried (or they do not meet where they should).
set -u
if [ "${1-}" != inside ]; then
    folder=$(mktemp -d) && trap 'rm -rf "$folder"' EXIT
    python3.11 -m venv "$folder/venv" || exit 2
    "$folder/venv/bin/pip" install --quiet 'ros-kilted-rclpy[fastrtps]==9.1.2' ros-kilted-std-msgs==5.5.1 ros-fastdds==3.2.3 || exit 2
    unshare -rnm true && [ -e /etc/machine-id ] || exit 2
    unshare -rnm bash "$0" inside "$folder"
    exit $?
fi

folder=$2
mount -t tmpfs none /run && mkdir /run/netns || exit 2
for device in 1 2; do
    ip netns add "device$device" && ip -n "device$device" link set lo up || exit 2
done
ip link add eth0 netns device1 type veth peer name eth0 netns device2 || exit 2
for device in 1 2; do
    ip -n "device$device" address add "10.90.0.$device/24" dev eth0 && ip -n "device$device" link set eth0 up || exit 2
done
for device in 1 2; do # a whitelist leaves out an interface that is not up yet
    until ip -n "device$device" -brief link show eth0 | grep -q " UP "; do sleep 0.1; done
done

cat >"$folder/node.py" <<'P'
import sys
import time

import rclpy
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node(sys.argv[1])
received = []
publisher = node.create_publisher(String, sys.argv[1], 10)
node.create_subscription(String, sys.argv[2], received.append, 10)
end = time.monotonic() + 15
while time.monotonic() < end and len(received) < 20:
    publisher.publish(String(data="here"))
    rclpy.spin_once(node, timeout_sec=0.1)
end = time.monotonic() + 2  # for the other, which may need some more
while time.monotonic() < end:
    publisher.publish(String(data="here"))
    time.sleep(0.1)
print("met" if received else "not met")
P

device() { # number, topic, the other's topic, machine id, whitelist
    local interfaces=""
    [ "$5" = whitelist ] && interfaces="<interfaceWhiteList><address>10.90.0.$1</address></interfaceWhiteList>"
    cat >"$folder/$1.xml" <<X
<dds xmlns="http://www.eprosima.com"><profiles>
  <transport_descriptors><transport_descriptor>
    <transport_id>udp</transport_id><type>UDPv4</type>$interfaces
  </transport_descriptor></transport_descriptors>
  <participant profile_name="device" is_default_profile="true"><rtps>
    <userTransports><transport_id>udp</transport_id></userTransports><useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles></dds>
X
    echo "$4" >"$folder/machine-id.$1"
    ip netns exec "device$1" unshare -m bash -c "mount --bind '$folder/machine-id.$1' /etc/machine-id &&
        exec env -u ROS_STATIC_PEERS -u ROS_DISCOVERY_SERVER ROS_DOMAIN_ID=90 ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET \
        RMW_IMPLEMENTATION=rmw_fastrtps_cpp FASTDDS_DEFAULT_PROFILES_FILE='$folder/$1.xml' \
        '$folder/venv/bin/python' '$folder/node.py' $2 $3"
}

pair() { # second machine id, whitelist or none
    device 1 one two 11111111111111111111111111111111 "$2" >"$folder/first" 2>&1 &
    local second
    second=$(device 2 two one "$1" "$2" 2>&1 | tail -1)
    wait $!
    echo "$(tail -1 "$folder/first"), $second"
}

same=11111111111111111111111111111111 other=22222222222222222222222222222222
differ=$(pair $other whitelist) alike=$(pair $same whitelist) free=$(pair $same none)
echo "whitelist, unlike machine ids: $differ"
echo "whitelist, one machine id:     $alike"
echo "one machine id, no whitelist:  $free"
[ "$differ" = "met, met" ] && [ "$free" = "met, met" ] || exit 2
[ "$alike" = "not met, not met" ] || exit 1
exit 0
