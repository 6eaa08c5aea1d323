"""What all tests share: no display, plain terminals, interrupts that are heard, Hypothesis runs that repeat exactly."""

from __future__ import annotations

import os
import signal

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

# What commands print is compared as plain text of one width, whatever terminal or service runs the tests.
os.environ["COLUMNS"] = "120"
for variable in ("FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS"):
    os.environ.pop(variable, None)

# What shells start in the background ignores Ctrl-C, and so would all that the tests start: it is heard again.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=50, database=None)
settings.load_profile("repeatable")
