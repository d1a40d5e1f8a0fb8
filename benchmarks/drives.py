"""Drives of a study at one time: control steps a second of each, stored and encoded as the server does; no sockets.

python benchmarks/drives.py --drives 4 8 16 24 --out benchmarks/results/drives.json
"""

import json
import os
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from options import Option, parse
from timing import stopwatch, write_json

from sean_jax.config import StudioConfig, validate
from sean_jax.studies.survey.answers import Answers
from sean_jax.studies.survey.drive import Drive, Sessions
from sean_jax.studies.survey.server import PICTURE, PICTURE_INTERVAL
from sean_jax.studies.survey.study import Study


def rates(sessions: Sessions, answers: Answers, config: StudioConfig, drives: int, view: str, seconds: float) -> list:
    """Control steps a second of each drive."""
    running = [Drive(answers, sessions.make(config), k, 0) for k in range(drives)]
    ended = threading.Event()

    def watch(drive: Drive) -> None:
        while not ended.wait(PICTURE_INTERVAL):
            drive.session.picture(view, *PICTURE)

    watchers = [threading.Thread(target=watch, args=(drive,)) for drive in running] if view != "plan" else []
    if watchers:
        running[0].session.picture(view, *PICTURE)  # compile
    for drive in running:
        drive.start()
    for watcher in watchers:
        watcher.start()
    time.sleep(2.0)
    before = [len(drive.session.commands) for drive in running]
    with stopwatch() as watch:
        time.sleep(seconds)
        steps = [len(drive.session.commands) - first for drive, first in zip(running, before, strict=True)]
    ended.set()
    for watcher in watchers:
        watcher.join()
    for drive in running:
        drive.close()
    return [count / watch.seconds for count in steps]


def main() -> None:
    """Print the table, and write it."""
    chosen = parse(
        __doc__,
        environment="lab",
        people=6,
        drives=[4, 8, 16, 24],
        views=["plan", "first_person"],
        seconds=10.0,
        out=Option(None, kind=Path),
    )
    options = {"environment": chosen.environment, "people": chosen.people, "time_limit": 120.0}
    config = validate(StudioConfig, options)
    trials = [{"name": "drive", "drive": {}}]
    study = Study.model_validate({"title": "drives", "consent": "-", "participants": 1, "trials": trials})
    rows, load = [], os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        answers, sessions = Answers.begin(Path(folder), study), Sessions()
        for view in chosen.views:
            for drives in chosen.drives:
                steps_per_second = rates(sessions, answers, config, drives, view, chosen.seconds)
                rows.append({"view": view, "drives": drives, "median": round(float(np.median(steps_per_second)), 2),
                             "slowest": round(min(steps_per_second), 2)})  # fmt: skip
                print(json.dumps(rows[-1]), flush=True)
        answers.close()
    if chosen.out is not None:
        content = {"environment": chosen.environment, "people": chosen.people, "cores": os.cpu_count(), "load": load}
        write_json(chosen.out, content | {"steps_per_second": rows})


if __name__ == "__main__":
    main()
