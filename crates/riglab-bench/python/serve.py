"""Requests in, replies out: one JSON object a line, until standard input ends.

What libraries print goes to standard error, so that it cannot mix with replies.
"""

import json
import os
import sys
import traceback


def serve(handlers):
    """Answers `{"do": NAME, ...}` with `{"ok": handlers[NAME](...)}` or `{"error": sentence}`."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            reply = {"ok": handlers[request.pop("do")](**request)}
        except Exception as e:
            traceback.print_exc()
            reply = {"error": f"{type(e).__name__}: {e}".splitlines()[0]}
        print(json.dumps(reply), file=replies, flush=True)


def peak_memory_mb():
    """The most memory this process has held, in MB."""
    with open("/proc/self/status") as f:
        # The kernel's "kB" are 1024 bytes, as on riglab's side.
        return next(int(line.split()[1]) * 1.024 / 1e3 for line in f if line.startswith("VmHWM:"))
