"""Homes the machine behind a pseudo-terminal and streams a program with grbl-streamer.

Usage: streamer.py PTY PROGRAM. Exit code 0 when the whole program was acknowledged without an error
and the machine stands still.
"""

import sys
import threading
import time

from grbl_streamer import GrblStreamer

LIMIT_S = 120
# Where job.ngc ends, mm.
END = (-3.0, 2.0, 47.5)

pty, program = sys.argv[1:3]
events = {name: threading.Event() for name in ("on_boot", "on_job_completed")}
errors = []
state = {}


def callback(name, *data):
    if name in events:
        events[name].set()
    elif name in ("on_error", "on_alarm"):
        errors.append((name, data))
    elif name == "on_stateupdate":
        state["mode"], state["machine"] = data[0], data[1]


def wait(what, holds):
    until = time.monotonic() + LIMIT_S
    while not holds():
        if time.monotonic() > until:
            sys.exit(f"waited for {what}: {state} {errors}")
        time.sleep(0.05)


grbl = GrblStreamer(callback)
grbl.setup_logging()
grbl.cnect(pty, 115200)
wait("the banner", events["on_boot"].is_set)
grbl.poll_start()
grbl.homing()
wait("homing", lambda: state.get("mode") == "Home")
wait("the home pose", lambda: state.get("mode") == "Idle")
grbl.incremental_streaming = False
with open(program, encoding="ascii") as file:
    grbl.write(file.read())
grbl.job_run()
wait("motion", lambda: state.get("mode") == "Run")
wait("the job", events["on_job_completed"].is_set)
wait("standstill", lambda: state.get("mode") == "Idle")
grbl.poll_stop()
grbl.disconnect()
if errors:
    sys.exit(f"errors: {errors}")
if any(abs(at - end) > 0.001 for at, end in zip(state["machine"], END)):
    sys.exit(f"the machine stands at {state['machine']} and not at {END}")
print("machine position", *state["machine"])
