"""A stand-in for Integration Service 3.1.0: it reads a configuration, refuses what the real program refused here, and serves.

It forwards nothing. `install` puts it below a folder as a colcon installation with the given system handles.
"""

import os
import signal
import sys
from pathlib import Path


def install(prefix, *handles):
    """Install the program with these system handles; return the folder of the program."""
    for handle in handles:
        folder = prefix / "lib" / "is" / handle
        folder.mkdir(parents=True)
        (folder / f"{handle}.mix").write_text("dl: ...\n")
    (prefix / "bin").mkdir(parents=True)
    program = prefix / "bin" / "integration-service"
    program.write_text(f"#!{sys.executable}\n{Path(__file__).read_text()}")
    program.chmod(0o755)
    return program.parent


def log(level, text):
    colour = {"ERROR": "\x1b[31m", "INFO": ""}[level]
    print(
        f"\x1b[1m{colour}[Integration Service][{level}] \x1b[0m\x1b[1m[is::core::Config]\x1b[0m {text}\x1b[0m",
        flush=True,
    )


def fail(text):
    log("ERROR", text)
    return 1


def is_installed(handle):
    folders = [folder for folder in os.environ.get("IS_PREFIX_PATH", "").split(os.pathsep) if folder]
    return any((Path(folder) / "is" / handle / f"{handle}.mix").exists() for folder in folders)


def main(path):
    from ruamel.yaml import YAML

    configuration = YAML(typ="safe").load(Path(path).read_text())
    for system in configuration["systems"].values():
        if not is_installed(system["type"]):
            log("ERROR", f"Unable to find .mix file for middleware '{system['type']}'.")
            return fail("Failed to load middlewares!")
    for topic in configuration["topics"].values():
        for system in configuration["systems"].values():
            if system["type"] == "ros2_dynamic":
                if "/" in topic["type"]:  # the type is not in its registry, and it does not look
                    os.kill(os.getpid(), signal.SIGSEGV)
                if topic["type"] not in {name.replace("/", "::msg::") for name in system.get("using", ())}:
                    return fail("Failed to configure topics!")
            elif "::" in topic["type"]:
                return fail("Failed to configure topics!")
    log("INFO", "serves")
    signal.sigwait({signal.SIGINT})
    return 0


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    sys.exit(main(sys.argv[1]))
