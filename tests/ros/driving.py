"""
Processes of robot and node over real DDS, in a domain of their own and on this machine alone.

`python -m tests.ros.driving [folder]` drives the guide's robot for two minutes: `make robot`.
"""

import os
import subprocess
import sys
import sysconfig
import tempfile
from contextlib import contextmanager
from pathlib import Path

from trustlab.ros import RobotRun, read_run

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "how_to" / "robot"
PEER = ROOT / "tests" / "ros" / "peer.py"
# ROS 2 is not in the package's environment: its wheels restart every Python.
ENVIRONMENT = ROOT / "tests" / "ros" / ".venv"
PYTHON = ENVIRONMENT / "bin" / "python"
MISSING = "" if (ENVIRONMENT / ".stamp").exists() else "`make tests/ros/.venv/.stamp`, Linux x86-64"
UNICAST = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces>"
    '<NetworkInterface address="127.0.0.1"/></Interfaces></General><Discovery>'
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
# What the robot of peer.py has in place of the guide's.
TOPICS = """
[settings.watchdogs]
operator = { after = 0.5, action = "stop" }
[topics.odometry]
topic = "/pose"
type = "geometry_msgs/msg/PoseStamped"
fields = ["pose.position.x", "pose.position.y"]
"""


@contextmanager
def processes(folder: Path):
    """Yield what starts a Python process in a folder; what is left is killed in the end."""
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "CYCLONEDDS_URI": UNICAST,
        "PYTHONPATH": os.pathsep.join([str(ROOT), sysconfig.get_path("purelib")]),
    }
    running: list[subprocess.Popen] = []

    def start(*command: object) -> subprocess.Popen:
        with open(folder / f"{len(running)}.log", "w") as log:
            arguments = [str(part) for part in (PYTHON, *command)]
            process = subprocess.Popen(
                arguments, cwd=folder, env=environment, stdout=log, stderr=subprocess.STDOUT
            )
        running.append(process)
        return process

    try:
        yield start
    finally:
        for process in running:
            process.kill()
            process.wait()


def run_for_peer(folder: Path) -> Path:
    """Write the guide's run, for the robot of peer.py."""
    (folder / "run.toml").write_text((EXAMPLE / "run.toml").read_text() + TOPICS)
    return folder / "run.toml"


def driven(folder: Path, robot: list[object], run: Path, duration: float) -> RobotRun:
    """Drive a robot, and return the run from the bag left in `folder`/runs."""
    with processes(folder) as start:
        start(*robot)
        node = start("-m", "trustlab.ros", run, "--duration", duration)
        if node.wait(duration + 120) != 0:
            raise RuntimeError((folder / "1.log").read_text())
    return read_run(max((folder / "runs").glob("*.mcap")))


def main() -> None:
    """Drive the guide's robot, and draw the chapter from its bag."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print(f"driving for two minutes; bag, session and chapter will be in {folder}")
    robot = [EXAMPLE / "simulated_robot.py"]
    run = driven(folder, robot, EXAMPLE / "run.toml", 120.0)
    print(run)
    import papermill

    chapter = ROOT / "notebooks" / "12_robot.ipynb"
    parameters = {"BAG": str(run.path)}
    papermill.execute_notebook(chapter, folder / chapter.name, parameters, cwd=ROOT / "notebooks")


if __name__ == "__main__":
    main()
