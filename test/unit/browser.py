"""A real Chromium without a window, for tests of pages: opens one, asks it something, and listens to its complaints.

The page is in a frame of another one, which asks; no port is opened, and no network is used.
"""
from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", "--enable-logging=stderr",
           # The one page may look into the other.
           "--disable-web-security", "--allow-file-access-from-files",
           # Without them it looks its maker's hosts up at each start.
           "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic",
           "--no-first-run", "--no-default-browser-check", "--disable-extensions")
PATIENCE_S = 60
FRAME = """<!doctype html><pre></pre><script>
const frame = document.createElement("iframe");
frame.width = 1100;
frame.onload = () => document.querySelector("pre").textContent = JSON.stringify(
  EXPRESSIONS.map(text => Function("document", "return " + text)(frame.contentDocument)));
frame.src = "PAGE";
document.body.append(frame);
</script>"""


def find_browser() -> str | None:
    """The path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


def look_at(browser: str, page: Path, *expressions: str) -> tuple[list, list[str]]:
    """Return what JavaScript expressions are on a page, as JSON has it, and the lines of its console."""
    with tempfile.TemporaryDirectory() as folder:
        frame = Path(folder, "frame.html")
        frame.write_text(FRAME.replace("EXPRESSIONS", json.dumps(expressions)).replace("PAGE", page.resolve().as_uri()),
                         encoding="utf-8")
        done = subprocess.run([browser, *OPTIONS, f"--user-data-dir={folder}/profile", frame.as_uri()],
                              capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    (answers,) = re.findall("<pre>(.+)</pre>", done.stdout, re.S)
    return json.loads(html.unescape(answers)), re.findall("CONSOLE.*", done.stderr)
