"""A robot and a laptop on one machine: two network namespaces, the robot's clocks two seconds ahead in a time namespace.

    sudo python benchmarks/two_machines.py OUT SECONDS [KBIT]

A camera of 100 KB at 15 Hz on the robot, a detector on the laptop that answers with the same stamp; a tap and a beacon on each. KBIT
limits the link in both directions. The traces are in OUT; `dds-trace analyze OUT` joins them. Needs root, iproute2, and ROS 2 or its wheels.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from contextlib import ExitStack, suppress
from pathlib import Path

ROBOT, LAPTOP = f"robot{os.getpid()}", f"laptop{os.getpid()}"
AHEAD_S = 2
CAMERA, DETECTOR = "camera", "detector"
IMAGE_BYTES, RATE_HZ, STAMP_AGE_S, WORK_S = 100_000, 15, 0.004, 0.008


def ip(*words: str) -> None:
    """Run `ip`."""
    subprocess.run(["ip", *words], check=True)


def make_machines(stack: ExitStack, kbit: str) -> None:
    """Make both namespaces and the cable between them."""
    for name in (ROBOT, LAPTOP):
        ip("netns", "add", name)
        stack.callback(ip, "netns", "delete", name)
    ip("link", "add", "eth0", "netns", ROBOT, "type", "veth", "peer", "name", "eth0", "netns", LAPTOP)
    for number, name in enumerate((ROBOT, LAPTOP), 1):
        ip("-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", "eth0")
        for link in ("lo", "eth0"):
            ip("-n", name, "link", "set", link, "up")
        ip("-n", name, "route", "add", "224.0.0.0/4", "dev", "eth0")
        if kbit:
            limit = ("root", "tbf", "rate", f"{kbit}kbit", "burst", "32kb", "latency", "400ms")
            subprocess.run(["tc", "-n", name, "qdisc", "add", "dev", "eth0", *limit], check=True)


def start(stack: ExitStack, boot: Path, name: str, *command: str) -> subprocess.Popen[bytes]:
    """Start a program on one of the machines; it is interrupted at the end."""
    # A machine of its own has a boot of its own.
    own = (
        ["sh", "-c", f'mount --bind {boot} /proc/sys/kernel/random/boot_id && exec "$@"', "sh"] if name == ROBOT else []
    )
    ahead = ["unshare", "--fork", "--kill-child", "-T", "--monotonic", str(AHEAD_S)] if name == ROBOT else []
    environment = {**os.environ, "ROS_DOMAIN_ID": "10", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"  # both sides see one /dev/shm
    process = subprocess.Popen(
        ["ip", "netns", "exec", name, *own, *ahead, sys.executable, *command], env=environment, start_new_session=True
    )
    stack.callback(stop, process)
    return process


def stop(process: subprocess.Popen[bytes]) -> None:
    """Interrupt a program and all that it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def record(out: Path, seconds: float, kbit: str) -> None:
    """Record both machines for some seconds."""
    out.mkdir(parents=True)
    with ExitStack() as stack:
        boot = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "boot_id"
        boot.write_text(f"{uuid.uuid4()}\n", encoding="ascii")
        make_machines(stack, kbit)
        start(stack, boot, ROBOT, __file__, CAMERA)
        start(stack, boot, LAPTOP, __file__, DETECTOR)
        time.sleep(5)
        common = ("--backend", "ros2", "--domain", "10", "--discovery", "subnet", "--connectivity", "wired")
        recorders = [
            start(stack, boot, name, "-m", "dds_trace.cli.record", "--role", role, *common, "--device", device, *more)
            for name, device in ((ROBOT, "robot"), (LAPTOP, "laptop"))
            for role, more in (
                ("beacon", ("--out", str(out / f"{device}-beacon.mcap"), "--rate", "4")),
                ("tap", ("--out", str(out / f"{device}-tap.mcap"), "--topics", "/camera/image,/detections")),
            )
        ]
        time.sleep(seconds)
        for process in recorders:
            os.killpg(process.pid, signal.SIGINT)
        for process in recorders:
            process.wait(60)


def publish(role: str) -> None:
    """Be the camera of the robot, or the detector of the laptop, until interrupted."""
    import rclpy  # noqa: PLC0415 - only the nodes need ROS 2
    from rclpy.qos import qos_profile_sensor_data  # noqa: PLC0415
    from sensor_msgs.msg import Image  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node(role)
    if role == CAMERA:
        publisher = node.create_publisher(Image, "/camera/image", qos_profile_sensor_data)
        message = Image(height=100, width=1000, step=1000, encoding="mono8")
        message.header.frame_id = "camera"

        def shoot() -> None:
            stamp = node.get_clock().now()
            time.sleep(STAMP_AGE_S)
            message.header.stamp = stamp.to_msg()
            message.data = os.urandom(IMAGE_BYTES)
            publisher.publish(message)

        node.create_timer(1 / RATE_HZ, shoot)
    else:
        publisher = node.create_publisher(Image, "/detections", qos_profile_sensor_data)

        def detect(image: Image) -> None:
            time.sleep(WORK_S)
            publisher.publish(Image(header=image.header, data=os.urandom(400)))

        node.create_subscription(Image, "/camera/image", detect, qos_profile_sensor_data)
    with suppress(KeyboardInterrupt):
        rclpy.spin(node)


if __name__ == "__main__":
    if sys.argv[1] in (CAMERA, DETECTOR):
        publish(sys.argv[1])
    else:
        record(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "")
