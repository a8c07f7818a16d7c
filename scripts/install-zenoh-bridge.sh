#!/usr/bin/env bash
# Builds zenoh-bridge-dds and zenoh-bridge-ros2dds as zenoh's router with its plugins for DDS and for ROS 2, from the crates
# `zenohd`, `zenoh-plugin-dds` and `zenoh-plugin-ros2dds`, and puts the three where `dds-trace bridge` finds them. Takes cargo 1.85
# or newer, a C compiler, cmake and libclang, and about 20 minutes on one core (ZENOH_BUILD_JOBS to use more), 1.3 GB on
# disk meanwhile.
#
# A plugin must be built by the same compiler against the same zenoh as its router, with the same features of every
# crate that they share: so all are members of one workspace, which resolves and builds those crates once.
set -euo pipefail

version="${ZENOH_VERSION:-1.10.2}"
target="${XDG_DATA_HOME:-$HOME/.local/share}/dds-trace/zenoh-bridge-dds"
plugins="dds ros2dds"
jobs="${ZENOH_BUILD_JOBS:-1}"

stop() {
    echo "install-zenoh-bridge: $1" >&2
    exit 1
}

command -v cargo >/dev/null || stop "cargo is not installed; get it from https://rustup.rs"
command -v cmake >/dev/null || stop "cmake is not installed (it builds Cyclone DDS); apt install cmake"
command -v cc >/dev/null || stop "a C compiler is not installed (it builds Cyclone DDS); apt install build-essential"

# bindgen looks for libclang by itself, but not in the folders of Debian's versioned packages. `libclang-cpp.so`, which
# many machines have without the other, is the C++ library: bindgen cannot use it.
if [ -z "${LIBCLANG_PATH:-}" ] && ! ldconfig -p | grep -q 'libclang\(-[0-9.]*\)\?\.so'; then
    found="$(find /usr/lib/llvm-*/lib -maxdepth 1 \( -name 'libclang.so*' -o -name 'libclang-[0-9]*.so*' \) -print -quit 2>/dev/null || true)"
    [ -n "$found" ] || stop "libclang is not installed (it reads Cyclone DDS's headers); apt install libclang-dev"
    LIBCLANG_PATH="$(dirname "$found")"
    export LIBCLANG_PATH
fi

is_there() {
    # Says nothing of the version that is there if there is none.
    "$target/zenohd" --version 2>/dev/null | grep -q "zenohd v$version " || return 1
    for plugin in $plugins; do
        [ -f "$target/libzenoh_plugin_$plugin.so" ] || return 1
    done
}

if is_there; then
    echo "zenohd $version with its plugins ($plugins) is there already: $target"
    exit 0
fi

work="$(mktemp -d "${TMPDIR:-/tmp}/zenoh-bridge-XXXXXX")"
trap 'rm -rf "$work"' EXIT

# `cargo info` unpacks a crate into cargo's own folder. A workspace needs its source, as zenohd is no library that
# another crate could depend on.
for crate in zenohd zenoh-plugin-dds zenoh-plugin-ros2dds; do
    cargo info --quiet "$crate@$version" >/dev/null 2>&1 || stop "cargo cannot reach the crate $crate $version"
    source="$(find "${CARGO_HOME:-$HOME/.cargo}"/registry/src -maxdepth 2 -name "$crate-$version" -print -quit)"
    [ -n "$source" ] || stop "cargo did not unpack the crate $crate $version; cargo 1.85 or newer does"
    cp -r "$source" "$work/$crate"
done
# The versions that the plugin's authors tested with; cargo adds what zenohd needs beyond them.
mv "$work/zenoh-plugin-ros2dds/Cargo.lock" "$work/Cargo.lock"
rm -f "$work/zenohd/Cargo.lock" "$work/zenoh-plugin-dds/Cargo.lock"
cat >"$work/Cargo.toml" <<'TOML'
[workspace]
resolver = "2"
members = ["zenohd", "zenoh-plugin-dds", "zenoh-plugin-ros2dds"]

[profile.release]
strip = true
TOML

echo "building zenohd $version and its plugins ($plugins) with $(cargo --version), $jobs job(s) ..." >&2
cd "$work"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$work/target}"
cargo build --release --jobs "$jobs" -p zenohd -p zenoh-plugin-dds -p zenoh-plugin-ros2dds

mkdir -p "$target"
install -m 755 "$CARGO_TARGET_DIR"/release/{zenohd,libzenoh_plugin_dds.so,libzenoh_plugin_ros2dds.so} "$target"
"$target/zenohd" --version | tail -n 1
echo "Wrote $target"
