"""Size of a replay page, and its frames per second in Chromium. It needs `npm ci` in web/, and Chromium.

python benchmarks/replay.py
python benchmarks/replay.py --people 62 --width 420
"""

import dataclasses
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse

import sean_jax
from sean_jax.web import replay

WEB = Path(__file__).parent.parent / "web"


def stand(scenario: sean_jax.Scenario, state: sean_jax.State, key: jax.Array) -> jax.Array:
    """Wait at the start of the task, so that the crowd moves for the whole time."""
    return jnp.zeros(2)


def main() -> None:
    """Print one line."""
    chosen = parse(
        __doc__,
        people=200,
        frames=1200,
        width=Option(1100, "of the window, in pixels"),
        seconds=5.0,
    )
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None or not (WEB / "node_modules" / "playwright-core").is_dir():
        sys.exit("there is no Chromium, or web/node_modules is not there (`npm ci` in web/ makes it)")
    scenario = sean_jax.make("warehouse", people=chosen.people, time_limit=chosen.frames / 10)

    @jax.jit
    def walked(key):
        return sean_jax.rollout(scenario, stand, key, steps=chosen.frames)[1]

    frames = jax.tree.map(np.asarray, walked(jax.random.key(0)))
    frames = dataclasses.replace(frames, active=np.ones(chosen.frames, bool))  # all are shown
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(replay.html(replay.of_scenario(scenario, [replay.ReplayEpisode(frames, "one")], "speed")))
        words = ["node", "test/speed.mjs", str(page), browser, str(chosen.width), str(chosen.seconds)]
        figures = json.loads(subprocess.run(words, cwd=WEB, check=True, capture_output=True).stdout)
        size = page.stat().st_size / 1e6
    print(
        f"{chosen.people} people, {chosen.frames} frames, {size:.2f} MB: {figures['frames_per_second']:.1f} frames/s, "
        f"99 % within {figures['slowest_percent_ms']:.0f} ms, busy {figures['busy_ms_per_frame']:.1f} ms a frame"
    )


if __name__ == "__main__":
    main()
