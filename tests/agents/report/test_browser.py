"""The page in a browser: no sideways scrolling on a phone, wide tables scroll within themselves, nothing goes wrong."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from benchmarks import made_up_folder

from lanebound.agents.report import write_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium to open the page in: apt-get install chromium")
PHONE_PX, LAPTOP_PX = 390, 1366
PROBE = """<script>addEventListener("load", () => {
  document.querySelectorAll("details").forEach((folded) => { folded.open = true; });
  const root = document.documentElement, parts = [...document.querySelectorAll(".scroll")];
  const wide = parts.filter((part) => part.scrollWidth > part.clientWidth).length;
  const out = [...document.querySelectorAll("main *")].filter((part) => !part.closest(".scroll, pre, .hidden, svg")
    && part.getBoundingClientRect().right > root.clientWidth + 0.5).length;
  const shown = [...document.querySelectorAll("[data-shows=overview]")].filter((part) => !part.hidden).length;
  parent.postMessage([innerWidth, root.scrollWidth, wide, out, shown].join(" "), "*");
});</script>"""
FRAME = """<!doctype html><body style="margin:0"><script>addEventListener("message", (event) => {{
  document.body.dataset.found = event.data; }});</script><iframe src="{page}" width="{width}" height="800"></iframe>"""


@pytest.fixture(scope="module", params=[3, 8])
def page(request, tmp_path_factory) -> Path:
    """A page with too few seeds for a verdict, and one with the longest legends."""
    folder = tmp_path_factory.mktemp("results")
    return write_report(made_up_folder(folder, seeds={"count": request.param}), folder, clips=0)


def opened(page: Path, width_px: int, tmp_path: Path) -> tuple[list[int], str]:
    """What the probe found in a frame of that width (windows may not be as narrow), and what the browser said."""
    probed, frame = tmp_path / "probed.html", tmp_path / "frame.html"
    text = page.read_text(encoding="utf-8")
    probed.write_text(text.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    frame.write_text(FRAME.format(page=probed.as_uri(), width=width_px), encoding="utf-8")
    command = [
        str(BROWSER), "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
        f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1400,900", "--virtual-time-budget=5000", "--dump-dom",
        frame.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'data-found="([\d ]+)"', done.stdout)
    assert found, done.stderr[-2000:]
    return [int(word) for word in found[1].split()], done.stderr


@pytest.mark.parametrize("width_px", [320, PHONE_PX, LAPTOP_PX])
def test_only_tables_scroll_sideways_and_nothing_goes_wrong(page, width_px, tmp_path):
    (inner, needed, wide, out, shown), said = opened(page, width_px, tmp_path)
    assert inner == width_px
    assert needed <= inner
    assert out == 0
    assert wide > 0 or width_px == LAPTOP_PX
    assert shown == 1
    assert "CONSOLE" not in said
