"""``sean export agent``: the best agent of a training in two small files, and how it came about."""

from pathlib import Path
from typing import Any

from sean_jax import components, files, registry, writing
from sean_jax.errors import InputError
from sean_jax.learning import agents, trained
from sean_jax.learning.logs import read_lines
from sean_jax.learning.manifests import CONFIG
from sean_jax.versions import versions
from sean_jax.writing import check_new_folder


def pack(folder: Path | str, out: Path | str) -> Path:
    """Write the best agent of a training into a small folder, which drives as the training's does.

    Files of one's own that the training names, and what they import beside them, are copied into its ``parts``.

    Args:
        folder: that ``sean train ppo`` has written, or is writing.
        out: folder to write, new or empty.

    Raises:
        InputError: there is no agent.
        WriteError: the folder cannot be written.
        IncompleteError: the checkpoint cannot be read.
    """
    folder, out = Path(folder), Path(out)
    check_new_folder(out)
    options = agents.read_options(folder)
    if agents.is_packed(folder):
        raise InputError(f"{folder} is packed already; copy it.")
    components.check_trust(options)
    _, agent, _ = trained.load(folder, registry.build(options.per_environment[0]).scenario)
    told = {**_best(folder), "weights": "float16", "packed_with": versions()}
    with writing.atomic_folder(out) as made:
        copies, hashes = components.copy(made, options)
        own = components.relocate(options.identity(), copies) | {"parts": hashes} if copies else {}
        agents.save(made, agent, {**files.read_json(folder / CONFIG), **own, "agent": told})
    return out


def _best(folder: Path) -> dict[str, Any]:
    """When the training found its best agent, and what the evaluation then said of all situations together."""
    judged = [
        (part["return"], line, part)
        for line in read_lines(folder)
        for name, part in line.items()
        if name == "evaluation" or name.startswith("agent ")  # one of several may be better than all on average
    ]
    if not judged:
        return {}
    _, best, part = max(judged, key=lambda each: (each[0], each[1]["epoch"]))
    figures = {name: value for name, value in part.items() if " in " not in name}
    return {"updates": best["epoch"], "steps": best["steps"], "evaluation": figures}
