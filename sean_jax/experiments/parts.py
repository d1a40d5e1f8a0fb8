"""What an experiment has finished: whole files, which are taken up again."""

import json
from pathlib import Path
from typing import Any

from sean_jax import writing
from sean_jax.experiments.options import Experiment
from sean_jax.learning.options import Refused
from sean_jax.versions import differing, versions

OPTIONS = "experiment.json"


def begun(options: Experiment) -> bool:
    """Whether it was begun in its folder. Raises Refused if that holds another experiment or something else.

    Parts that two versions have made would not belong together.
    """
    folder, asked = options.folder, options.lasting()
    if (folder / OPTIONS).is_file():
        try:
            kept = json.loads((folder / OPTIONS).read_text(encoding="utf-8"))
            had, made_with = kept["options"], kept.get("versions")
            if not isinstance(had, dict):
                raise TypeError
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise Refused(f"{folder / OPTIONS} is damaged; choose another folder with --out.") from None
        for name in asked:
            if asked[name] != had.get(name):
                said = f"--{name.replace('_', '-')} {had.get(name)}, not {asked[name]}"
                raise Refused(f"{folder} was begun with {said}; ask for the same or choose another --out.")
        if (other := differing(made_with)) is not None:
            raise Refused(f"{folder} was begun with {other}; go on with the same, or choose another --out.")
        return True
    if writing.contents(folder):
        raise Refused(f"the folder {folder} holds something else already, choose another with --out.")
    return False


def begin(options: Experiment) -> None:
    """The folder, which is held, with the options in it, if it was not begun."""
    if not begun(options):
        save(options.folder / OPTIONS, {"options": options.lasting(), "versions": versions()})


def save(path: Path, content: Any) -> None:
    """JSON, or text if it is a str."""
    text = content if isinstance(content, str) else json.dumps(content, indent=1, allow_nan=False) + "\n"
    writing.write(path, text)


def saved(path: Path) -> Any:
    """What was saved there, or None."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
