"""What an experiment has finished: files written under another name and renamed, and taken up again."""

import json
import os
from pathlib import Path
from typing import Any

from sean_jax.experiments.options import Experiment
from sean_jax.learning.options import Refused
from sean_jax.versions import versions

OPTIONS = "experiment.json"


def begin(options: Experiment) -> Path:
    """The folder, with the options in it. Raises Refused if it holds another experiment or something else."""
    folder, asked = options.folder, options.lasting()
    if folder.is_file():
        raise Refused(f"{folder} is a file, give the name of a folder with --out.")
    if (folder / OPTIONS).is_file():
        try:
            had = json.loads((folder / OPTIONS).read_text(encoding="utf-8"))["options"]
        except (ValueError, KeyError, TypeError):
            raise Refused(f"{folder / OPTIONS} is damaged; choose another folder with --out.") from None
        for name in asked:
            if asked[name] != had.get(name):
                said = f"--{name.replace('_', '-')} {had.get(name)}, not {asked[name]}"
                raise Refused(f"{folder} was begun with {said}; ask for the same or choose another --out.")
        return folder
    if folder.is_dir() and any(folder.iterdir()):
        raise Refused(f"the folder {folder} holds something else already, choose another with --out.")
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / OPTIONS, {"options": asked, "versions": versions()})
    return folder


def save(path: Path, content: Any) -> None:
    """JSON, or text if it is a str, under another name first."""
    text = content if isinstance(content, str) else json.dumps(content, indent=1, allow_nan=False) + "\n"
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def saved(path: Path) -> Any:
    """What was saved there, or None."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
