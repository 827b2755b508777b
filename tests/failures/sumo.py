#!/usr/bin/python3
"""Stands in for the program `sumo`: hands everything on to the real one, until a fault is due.

FAULT_REAL    the real program
FAULT_KIND    garbage: an answer that is no TraCI; cut: half an answer, then the end of the connection; slow: an answer
              byte by byte; silent: no answer; exit: the end of the process, with last words
FAULT_AFTER   number of answers that pass before
FAULT_ONCE    a file: the process that makes it misbehaves, others find it and do not; empty: all misbehave
"""

import ctypes
import os
import signal
import socket
import struct
import subprocess
import sys
import time

real, kind, after, once = (os.environ["FAULT_" + name] for name in ("REAL", "KIND", "AFTER", "ONCE"))
arguments = sys.argv[1:]
if "--remote-port" not in arguments:
    os.execv(real, [real, *arguments])
at = arguments.index("--remote-port") + 1
with socket.socket() as probe:
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
listener = socket.create_server(("127.0.0.1", int(arguments[at])))
arguments[at] = str(port)


def end_with_this_one():
    """Killed before it has connected, it would leave the real program waiting for a connection for good."""
    PR_SET_PDEATHSIG = 1
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


# Once connected, its end of the connection tells the real program that this one is gone, even if this one is killed.
sumo = subprocess.Popen([real, *arguments], preexec_fn=end_with_this_one)
ours, _ = listener.accept()
listener.close()
while True:
    try:
        theirs = socket.create_connection(("127.0.0.1", port))
        break
    except ConnectionRefusedError:
        time.sleep(0.002)
for connection in (ours, theirs):
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def message(connection):
    head = b""
    while len(head) < 4:
        chunk = connection.recv(4 - len(head))
        if not chunk:
            sys.exit()
        head += chunk
    body = b""
    length = struct.unpack("!i", head)[0] - 4
    while len(body) < length:
        body += connection.recv(length - len(body))
    return head + body


def due():
    if not once:
        return True
    try:
        os.close(os.open(once, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return False
    return True


answers = 0
while True:
    theirs.sendall(message(ours))
    answer = message(theirs)
    answers += 1
    if answers <= int(after) or not due():
        ours.sendall(answer)
    elif kind == "garbage":
        ours.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        time.sleep(60)
    elif kind == "cut":
        ours.sendall(answer[: len(answer) // 2])
        ours.close()
        time.sleep(60)
    elif kind == "slow":
        for byte in answer:
            ours.sendall(bytes([byte]))
            time.sleep(0.05)
    elif kind == "silent":
        time.sleep(60)
    elif kind == "exit":
        sumo.kill()
        sys.exit("Error: out of fuel")
