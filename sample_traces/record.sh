#!/usr/bin/env bash
# Records sample_traces/ anew on this machine over real ROS 2 and keeps what they must analyze to.
# Usage: just samples. The old recordings are replaced only when all new ones are there.
set -euo pipefail
cd "$(dirname "$0")"
bin=${DDS_TRACE_BIN:-../.venv/bin}
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST

new=$(mktemp -d)
relay=
stop_relay() { # by its own id, and wait until its trace is closed
  if [ -n "$relay" ]; then
    kill -TERM "$relay" 2>/dev/null || true
    wait "$relay" || true
    relay=
  fi
}
trap 'stop_relay; rm -rf "$new"' EXIT

start_relay() { # FOLDER OPTION...
  mkdir -p "$new/$1"
  "$bin/dds-record" --role relay --domain 10 --device beta --out "$new/$1/relay.mcap" "${@:2}" 2>"$new/said" &
  relay=$!
  grep -qm1 serves <(tail -f -n +1 --pid="$relay" "$new/said") # without a line of that kind the relay has ended
}
ping() { # FOLDER NAME OPTION...
  "$bin/dds-record" --role ping --device alpha --connectivity loopback --warmup 10 \
    --out "$new/$1/$2.mcap" "${@:3}"
}

start_relay same_domain
ping same_domain binary_33KB_20Hz --domain 10 --data binary --size 33KB --rate 20 --messages 120
ping same_domain binary_33KB_100Hz --domain 10 --data binary --size 33KB --rate 100 --messages 200
ping same_domain binary_145KB_20Hz --domain 10 --data binary --size 145KB --rate 20 --messages 120
ping same_domain string_91_50Hz --domain 10 --data string --size 91 --rate 50 --messages 150
ping same_domain imu_100Hz --domain 10 --data imu --rate 100 --messages 200
stop_relay

start_relay different_domains
ping different_domains binary_33KB_20Hz --bridge builtin --data binary --size 33KB --rate 20 --messages 120
ping different_domains binary_145KB_20Hz --bridge builtin --data binary --size 145KB --rate 20 --messages 120
ping different_domains string_91_50Hz --bridge builtin --data string --size 91 --rate 50 --messages 150
ping different_domains imu_100Hz --bridge builtin --data imu --rate 100 --messages 200
stop_relay

# Best effort over UDP with messages larger than the receive buffer: real losses on the way.
export FASTDDS_BUILTIN_TRANSPORTS=UDPv4
start_relay losses --reliability best_effort
ping losses binary_600KB_20Hz --domain 10 --data binary --size 600KB --rate 20 --messages 150 --reliability best_effort
stop_relay

for sample in same_domain different_domains losses; do
  "$bin/python" - "$new/$sample" >"$new/$sample.expected.json" <<'PY'
import json
import sys
from pathlib import Path

sys.path.insert(0, "../tests/support")
import bare

print(json.dumps(bare.summarize(bare.pair(*bare.load(Path(sys.argv[1])))).to_dicts(), indent=1))
PY
done
for sample in same_domain different_domains losses; do
  rm -rf "$sample"
  mv "$new/$sample" "$new/$sample.expected.json" .
done
du -sh .
