"""Topics as taps recorded them: joined over devices, with latency and age on one clock."""
