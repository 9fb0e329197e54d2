#!/usr/bin/env python3
"""Load of `haptimill serve` with its simulated machine, one viewer and a cut.

Usage, at the root of the repository:
    python3 host/web/tests/load.py [--apart] COMMAND [PROGRAM [STOCK]]

Prints the states per second, their largest gap, the bytes per second to the viewer, and the
processor time of the process in percent of one core, over 40 s of the program. With --apart the
machine is simulated in another process, at a pseudo-terminal, and does not count. Exits with an
error below 19.5 states per second, at an underrun, and with --apart above 5 % of one core: run it
on an idle computer.
"""

import base64
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time

SECONDS = 40.0


class Viewer:
    """A WebSocket client for text messages."""

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)))
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            (
                f"GET /ws HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n"
                f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Key: {key}\r\n\r\n"
            ).encode()
        )
        self.received = b""
        while b"\r\n\r\n" not in self.received:
            self.received += self.socket.recv(4096)
        self.received = self.received.split(b"\r\n\r\n", 1)[1]
        self.state = {}
        self.bytes = 0
        self.times = []
        self.underruns = set()

    def take(self, count):
        while len(self.received) < count:
            more = self.socket.recv(1 << 16)
            if not more:
                raise EOFError("the server closed the connection")
            self.received += more
            self.bytes += len(more)
        taken, self.received = self.received[:count], self.received[count:]
        return taken

    def next(self):
        first, second = self.take(2)
        length = second & 127
        if length == 126:
            (length,) = struct.unpack(">H", self.take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self.take(8))
        content = self.take(length)
        if first & 15 == 9:
            self.write(10, content)
        elif first & 15 == 1:
            message = json.loads(content)
            if message["kind"] == "state":
                self.state = message
                for entry in message["messages"]:
                    if "periods late" in entry["text"]:
                        self.underruns.add((entry["s"], entry["text"]))
                self.times.append(time.monotonic())
            elif message["kind"] == "refused":
                print("refused:", message["text"])

    def write(self, code, content):
        mask = os.urandom(4)
        length = len(content)
        if length < 126:
            head = bytes([128 | code, 128 | length])
        else:
            head = bytes([128 | code, 128 | 127]) + struct.pack(">Q", length)
        masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(content))
        self.socket.sendall(head + mask + masked)

    def command(self, **command):
        command["t"] = self.state.get("t", 0)
        self.write(1, json.dumps(command).encode())

    def wait(self, what, holds):
        until = time.monotonic() + 300
        while not holds(self.state):
            if time.monotonic() > until:
                raise TimeoutError(f"{what}: {self.state}")
            self.next()

    def answer(self):
        self.wait("a question", lambda state: state.get("question"))
        read = time.monotonic() + 0.6
        while time.monotonic() < read:
            self.next()
        self.command(command="answer", yes=True)
        self.wait("the answer", lambda state: not state.get("question"))


def processor_s(pid):
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:
        fields = file.read().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main():
    apart = sys.argv[1] == "--apart"
    command, *rest = sys.argv[1 + apart :]
    program, stock = (rest + ["examples/dome.ngc", "examples/block.toml"][len(rest) :])[:2]
    folder = tempfile.mkdtemp()
    name = os.path.basename(program)
    shutil.copy(program, folder)
    listen = ["--listen", "127.0.0.1:0", "--programs", folder]
    machine = None
    if apart:
        simulate = [command, "sim", "serve", "--stock", stock]
        machine = subprocess.Popen(simulate, stdout=subprocess.PIPE, text=True)
        port = machine.stdout.readline().strip()
        listen += ["--port", port, "--machine", "machines/h4.toml"]
    else:
        listen += ["--stock", stock]
    server = subprocess.Popen([command, "serve", *listen], stdout=subprocess.PIPE, text=True)
    try:
        viewer = Viewer(server.stdout.readline().strip().split("/")[2])
        viewer.wait("the machine", lambda state: state.get("state") == "disabled")
        viewer.command(command="take")
        viewer.next()
        viewer.command(command="home")
        viewer.answer()
        done = "home pose: done"
        viewer.wait(
            "homing", lambda state: any(done in it["text"] for it in state["messages"])
        )
        viewer.command(command="select", name=name)
        viewer.wait("the path", lambda state: state["selected"] == name and not state["planning"])
        viewer.command(command="run")
        viewer.answer()
        viewer.wait("the run", lambda state: (state["program"] or {}).get("line", 0) > 1)
        viewer.times.clear()
        begun, used, taken = time.monotonic(), processor_s(server.pid), viewer.bytes
        while time.monotonic() < begun + SECONDS:
            viewer.next()
        took = time.monotonic() - begun
        gaps = [after - before for before, after in zip(viewer.times, viewer.times[1:])]
        rate = len(viewer.times) / took
        load = 100 * (processor_s(server.pid) - used) / took
        print(
            f"{rate:.1f} states/s, largest gap {1000 * max(gaps):.0f} ms, "
            f"{(viewer.bytes - taken) / took / 1000:.0f} kB/s, "
            f"{load:.1f} % of one core, {len(viewer.underruns)} underruns"
        )
        if rate < 19.5 or viewer.underruns or (apart and load > 5.0):
            sys.exit("beyond the bounds")
    finally:
        for process in filter(None, (server, machine)):
            process.terminate()
            process.wait()
        shutil.rmtree(folder)


main()
