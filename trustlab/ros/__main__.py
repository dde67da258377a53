"""Run the allocation rule on a robot: python -m trustlab.ros run.toml."""

import argparse
import gc
import signal
import sys
import time
from pathlib import Path

from trustlab.ros.node import Allocation
from trustlab.ros.recorded import LOG, read_run
from trustlab.ros.run import read_toml
from trustlab.sessions.errors import SessionError


def main() -> None:
    """Run until Ctrl-C, a SIGTERM, or the time is over."""
    parser = argparse.ArgumentParser(prog="python -m trustlab.ros", description=__doc__)
    parser.add_argument("run", help="a TOML file")
    parser.add_argument("--folder", default="runs", help="where bag and session go")
    parser.add_argument("--duration", type=float, default=float("inf"), help="in seconds")
    options = parser.parse_args()
    if not options.duration > 0.0:
        parser.error(f"--duration must be positive, got {options.duration}")
    try:
        run = read_toml(options.run)
    except ValueError as error:
        parser.error(str(error))
    folder = Path(options.folder)
    folder.mkdir(parents=True, exist_ok=True)
    recover(folder)

    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    # The robot is stopped by a last command, for which ROS must still be there.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for ending in (signal.SIGTERM, signal.SIGHUP):  # the latter where a connection is lost
        signal.signal(ending, signal.default_int_handler)
    node = rclpy.create_node("trustlab_allocation")
    path = folder / f"{Path(options.run).stem}_{time.strftime('%Y%m%d-%H%M%S')}.mcap"
    allocation = Allocation(node, run, path)
    executor = SingleThreadedExecutor()  # `rclpy.spin_once` adds and removes the node each time
    executor.add_node(node)
    gc.collect()
    gc.freeze()  # else the collector looks through all imports now and then, a tenth of a second
    end = time.monotonic() + options.duration
    code = 0
    try:
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.2)
    except KeyboardInterrupt:
        pass
    finally:
        try:
            print(allocation.finish())
        except SessionError as error:
            print(f"{path}: {error}")
            code = 1
        rclpy.shutdown()
    sys.exit(code)


def recover(folder: Path) -> None:
    """Write bags and sessions of runs that were killed."""
    for path in sorted(folder.glob(f"*{LOG}")):
        try:
            print(f"of a run that was killed: {read_run(path, own_rules=True)}")
        except Exception as error:  # whatever is wrong with it, the next run goes on
            print(f"{path}: left as it is, {error}")


if __name__ == "__main__":
    main()
