"""Who walks together in a recording: groups that somebody annotated, as ETH and UCY come with them (section III).

A line names the people of a group by the numbers of the recording. The groups of section III stand in conversation;
these walk, so joining or leaving them is another matter.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Int

from sean_jax.errors import FileError
from sean_jax.files import read_text, short_name
from sean_jax.recordings.tracks import Tracks


def read_companions(path: str | Path, tracks: Tracks) -> Int[np.ndarray, " N"]:
    """The walking group of each person.

    Args:
        path: of a text file with a line for each group: the numbers of its people, with space between them. Lines that
            share somebody are one group.

    Returns:
        (N,) int32 column of the first member of the person's group, -1 alone.

    Raises:
        FileError: one sentence that names the file, the line and the cure.
    """
    column = {int(number): k for k, number in enumerate(np.asarray(tracks.person).max(0))}
    group = np.full(len(column), -1, np.int32)
    for line, text in enumerate(read_text(Path(path)).splitlines(), 1):
        members = []
        for word in text.split():
            if not word.isdecimal() or int(word) not in column:
                raise FileError(
                    f"{short_name(Path(path))}:{line}: {word[:40]!r} is the number of nobody in the recording; "
                    "give a line of people for each group."
                )
            members.append(column[int(word)])
        if members:
            shared = np.isin(group, group[members][group[members] >= 0])
            shared[members] = True
            group[shared] = np.flatnonzero(shared)[0]
    alone = np.bincount(group[group >= 0], minlength=len(group)) < 2
    return np.where((group >= 0) & alone[group], -1, group).astype(np.int32)
