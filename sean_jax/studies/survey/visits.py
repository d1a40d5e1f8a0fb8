"""How long a participant had each page of a study open, and its film in sight: from the events of the study's file.

The server notes each event with its own clock: a page tells what happens, and never when.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

OPENED, CLOSED = "opened", "closed"  # a tab
PAGE = "page"  # and its number: it was sent to the tab
BEGAN = "began"  # and the page's number: its film is played for the first time since it was opened
EARLY = "early"  # and the page's number: the participant went on before the film's end, and was refused
SHOWN = "shown"  # and the page's number: the film is over, and questions follow
HIDDEN, VISIBLE = "hidden", "visible"  # the tab is behind another one, or in front again
GRACE = 5.0  # s, for which a film goes on in a page whose connection is lost
EVENT = rf"^({OPENED}|{CLOSED}|{HIDDEN}|{VISIBLE}|({PAGE}|{BEGAN}|{EARLY}|{SHOWN}) [0-9]{{1,4}})$"


@dataclasses.dataclass
class Visit:
    """A participant's visits of a page; times are s since 1970, durations s."""

    opened: float
    began: float | None = None  # the film, for the first time
    dwell: float = 0.0  # that the page was open
    hidden: float = 0.0  # of these, that its tab was behind another one
    watched: float = 0.0  # that the film was played, without the time that the tab was closed or hidden
    is_over: bool = False  # the film
    reloads: int = 0
    early: int = 0  # times that the participant was refused to go on


def visits(events: Iterable[tuple[float, str]], now: float | None = None) -> dict[int, Visit]:
    """Page -> its visits, from the events of a participant in the order in which they were stored.

    A film is played from BEGAN on, until it is over or its tab is closed; then it stands until the next BEGAN. If this
    follows within ``GRACE``, the connection was lost, while the film went on. A killed server notes no CLOSED: a tab
    that is open at OPENED was so until the event before. A clock that is set back adds nothing.

    Args:
        now: until when the latest page is counted; until the latest event if None.
    """
    # Each event closes the time since the one before, which counts in the state of the tab at that time.
    found: dict[int, Visit] = {}
    number, before = -1, 0.0
    is_open = is_hidden = is_played = False
    lost: float | None = None  # when the tab was closed in which the film was played and in sight
    for time, what in [*events, *([] if now is None else [(now, "")])]:
        # Nothing counts up to OPENED: the server was off before it, for an unknown time.
        word, _, page = what.partition(" ")
        if (visit := found.get(number)) is not None and word != OPENED:
            passed = max(0.0, time - before)
            visit.dwell += passed * is_open
            visit.hidden += passed * (is_open and is_hidden)
            visit.watched += passed * (is_played and not is_hidden)
        before = time

        # A page that is sent again is a reload; the film of another page is not waited for.
        if word == PAGE:
            if int(page) != number:
                lost = None
            number, is_open, is_played = int(page), True, False
            if number in found:
                found[number].reloads += 1
            else:
                found[number] = Visit(opened=time)
        elif word in (OPENED, CLOSED):
            # A hidden film that is closed has not been watched: the lost time is not added later.
            if word == CLOSED and is_played:
                lost = None if is_hidden else time
            elif word == OPENED and is_open:
                lost = None
            is_open = is_hidden = is_played = False
        elif word in (HIDDEN, VISIBLE):
            is_hidden = word == HIDDEN
        elif word == BEGAN and int(page) == number and not found[number].is_over:
            visit, is_played = found[number], True
            visit.began = time if visit.began is None else visit.began

            # The film went on in the page during a short loss of the connection.
            if lost is not None and not is_hidden and time - lost <= GRACE:
                visit.watched += max(0.0, time - lost)
            lost = None
        elif word == SHOWN and int(page) == number:
            found[number].is_over, is_played = True, False
        elif word == EARLY and int(page) == number:
            found[number].early += 1
    return found
