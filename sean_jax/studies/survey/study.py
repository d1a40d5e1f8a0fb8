"""The description of a study, ``study.yaml``: participants, trials and questions.

A participant goes through the steps of the study: the questions before, the trials in the participant's order, the
questions after. A trial is an episode to watch, two episodes to choose from, or a drive.
"""

from __future__ import annotations

import functools
import math
import sys
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeGuard

import pydantic

from sean_jax.config import StudioConfig, validate
from sean_jax.core.errors import InputError
from sean_jax.core.messages import shorten, suggest
from sean_jax.io import files
from sean_jax.io.files import Problem
from sean_jax.web import local_server

VIEWS = ("plan", "first_person", "third_person")
BEFORE, AFTER, CHOICE = "before", "after", "choice"
MAX_TEXT = 2_000  # characters of an answer
MAX_PARTICIPANTS = 1_000
MAX_WORD = 1_000  # characters of a name of an episode or a policy, and of a choice
MAX_STUDY = 5_000_000  # characters of a study as JSON
LINES = "\n\r\t"  # control characters that a text may have
NAME = r"^[A-Za-z][A-Za-z0-9_-]{0,39}$"

Name = Annotated[str, pydantic.Field(pattern=NAME)]
Text = Annotated[str, pydantic.Field(min_length=1, max_length=10_000)]
Bound = Annotated[float, pydantic.Field(allow_inf_nan=False)]


class Part(pydantic.BaseModel):
    """A mapping of the file."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Template(Part):
    """A questionnaire: Likert items, and the scales that they belong to."""

    source: str
    text: str
    points: int
    ends: tuple[str, str]
    scales: dict[str, dict[str, str]]  # scale -> item -> text
    reversed: tuple[str, ...] = ()

    def score(self, scale: str, values: dict[str, float]) -> float | None:
        """The mean of a scale's items, from item -> answer; None if one is missing."""
        items = self.scales[scale]
        if not set(items) <= set(values):
            return None
        turned = [self.points + 1 - values[item] if item in self.reversed else values[item] for item in items]
        return sum(turned) / len(turned)


@functools.cache
def templates() -> dict[str, Template]:
    """The questionnaires of the package."""
    data = files.read_yaml(Path(__file__).with_name("templates.yaml"))[1]
    return {name: Template(**values) for name, values in data.items()}


class Question(Part):
    """A question, or a questionnaire by the name of its template."""

    kind: Literal["likert", "choice", "text", "number", "template"]
    name: Name
    text: Text | None = None
    points: Annotated[int, pydantic.Field(ge=2, le=11)] = 7
    ends: Annotated[list[str], pydantic.Field(min_length=2, max_length=2)] = ["strongly disagree", "strongly agree"]
    choices: Annotated[list[Text], pydantic.Field(max_length=50)] = []
    range: Annotated[list[Bound], pydantic.Field(min_length=2, max_length=2)] | None = None
    required: bool = True

    @pydantic.model_validator(mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {"kind": "template", "name": value} if isinstance(value, str) else value

    def problems(self) -> Iterator[Problem]:
        """Mistakes that no single field shows."""
        if self.name == CHOICE:
            yield ("name",), f"'{CHOICE}' is the name of the choice between two robots; choose another name"
        if self.kind == "template":
            if self.name not in templates():
                known = ", ".join(templates())
                cure = suggest(self.name, templates()) or "; give one of these, or a question of your own"
                yield (), f"'{self.name}' is not one of {known}{cure}"
            return
        if self.text is None:
            yield (), f"the question '{self.name}' has no text; add text: What do you think?"
        if self.kind == "choice" and len(self.choices) < 2:
            yield (), f"the question '{self.name}' has {len(self.choices)} choices; give two or more"
        if self.range is not None and not self.range[0] < self.range[1]:
            yield ("range",), f"{self.range} must be a lower and a higher number"

    def items(self) -> list[dict[str, Any]]:
        """The questions as the page shows them: a template has one for each item."""
        if self.kind == "template":
            template = templates()[self.name]
            items = [item for scale in template.scales.values() for item in scale.items()]
            shared = {"kind": "likert", "points": template.points, "ends": template.ends, "required": True}
            return [shared | {"name": f"{self.name}.{item}", "text": text, "group": template.text}
                    for item, text in items]  # fmt: skip
        used = {"likert": ("points", "ends"), "choice": ("choices",), "number": ("range",), "text": ()}
        names = ("kind", "name", "text", "required", *used[self.kind])
        return [{name: getattr(self, name) for name in names} | {"group": ""}]


Questions = Annotated[tuple[Question, ...], pydantic.Field(max_length=100)]
Options = dict[str, Any]


class Trial(Part):
    """An episode to watch, a drive, or two episodes to choose from, and the questions after it."""

    name: Name
    watch: Options | None = None
    drive: Options | None = None
    choose: Annotated[tuple[Options, ...], pydantic.Field(min_length=2, max_length=2)] | None = None
    text: Text | None = None
    questions: Questions | None = None

    @property
    def kinds(self) -> list[str]:
        """Those of watch, drive and choose that are given; a right trial has one."""
        return [kind for kind in ("watch", "drive", "choose") if getattr(self, kind) is not None]

    @property
    def kind(self) -> str:
        """watch, drive or choose."""
        return next(iter(self.kinds), "")

    @property
    def episodes(self) -> tuple[Options, ...]:
        """The options of each episode."""
        if self.choose is not None:
            return self.choose
        return tuple(options for options in (self.watch, self.drive) if options is not None)

    @property
    def view(self) -> str:
        """What a driver sees."""
        return (self.drive or {}).get("view", "plan")


class Step(Part):
    """A page of a participant: a trial and its questions, or questions alone."""

    name: str
    kind: str  # questions, or the trial's kind
    trial: int | None  # index of the trial
    text: str
    questions: tuple[dict[str, Any], ...]
    view: str = "plan"
    swapped: bool = False  # of two episodes, whether the second one is on the left

    def question(self, name: object) -> dict[str, Any] | None:
        """The question of a name."""
        return next((each for each in self.questions if each["name"] == name), None)


class Study(Part):
    """A study."""

    title: Text
    consent: Text
    thanks: Text = "Thank you. Your answers are stored. You can close this page."
    participants: Annotated[int, pydantic.Field(ge=1, le=MAX_PARTICIPANTS)]
    order: Literal["fixed", "balanced"] = "balanced"
    options: Options = {}
    questions: Questions = ()
    before: Questions = ()
    after: Questions = ()
    trials: Annotated[tuple[Trial, ...], pydantic.Field(min_length=1, max_length=100)]
    drivers: Annotated[int, pydantic.Field(ge=1, le=100)] = 8
    address: Text | None = None

    def identity(self) -> dict[str, Any]:
        """What must not change while a study runs."""
        return self.model_dump(mode="json", exclude={"drivers", "address"})

    def config(self, options: Options, source: Path) -> StudioConfig:
        """The options of an episode of the study.

        Args:
            source: the file of the study, whose own parts run if the user trusts it.

        Raises:
            InputError: one sentence that names the option, the value and the cure.
        """
        given = {name: value for name, value in options.items() if name not in ("view", "name")}
        return validate(StudioConfig, {**self.options, **given}, source=source)

    def unbalanced(self) -> str | None:
        """A sentence if the participants are too few, or too many, for orders that balance one another."""
        needed, trials = rows(len(self.trials)), len(self.trials)
        if self.order == "fixed" or self.participants % needed == 0:
            return None
        return (
            f"participants: {self.participants} are no multiple of {needed}, so the orders of {trials} trials are not "
            "fully balanced."
        )

    def steps(self, participant: int) -> list[Step]:
        """The pages of a participant, whose number begins at 0."""
        count = len(self.trials)
        order = sequence(count, participant) if self.order == "balanced" else range(count)
        before, after = (
            [Step(name=name, kind="questions", trial=None, text="", questions=_items(questions))] if questions else []
            for name, questions in ((BEFORE, self.before), (AFTER, self.after))
        )
        return [*before, *(self._step(participant, index) for index in order), *after]

    def _step(self, participant: int, index: int) -> Step:
        trial = self.trials[index]
        questions = _items(self.questions if trial.questions is None else trial.questions)
        swapped = False
        if trial.kind == "choose":
            questions = (_choice(trial.text or "Which robot do you prefer?"), *questions)
            swapped = bool((participant + participant // rows(len(self.trials)) + index) % 2)
        return Step(name=trial.name, kind=trial.kind, trial=index, text=trial.text or "", questions=questions,
                    view=trial.view, swapped=swapped)  # fmt: skip


def _items(questions: Iterable[Question]) -> tuple[dict[str, Any], ...]:
    return tuple(item for question in questions for item in question.items())


def _choice(text: str) -> dict[str, Any]:
    return {"kind": "choice", "name": CHOICE, "text": text, "choices": ("A", "B"), "required": True, "group": ""}


def read(path: Path) -> Study:
    """The study of a file.

    Raises:
        FileError: file, line, key, value and cure of each mistake.
    """
    return files.load(path, Study, functools.partial(_problems, path=path))


def name_problems(study: Study) -> Iterator[Problem]:
    """Mistakes in names, questions and kinds of trials, which options of episodes have no part in."""
    places: list[tuple[tuple[str | int, ...], Sequence[Question]]] = [
        ((name,), getattr(study, name)) for name in ("questions", "before", "after")
    ]
    places += [(("trials", k, "questions"), trial.questions or ()) for k, trial in enumerate(study.trials)]
    for loc, questions in places:
        for k, question in enumerate(questions):
            yield from (((*loc, k, *inner), clause) for inner, clause in question.problems())
        yield from _repeated(loc, [question.name for question in questions])
    yield from _repeated(("trials",), [trial.name for trial in study.trials])
    for k, trial in enumerate(study.trials):
        yield from _trial_problems(trial, ("trials", k))


def _problems(study: Study, path: Path) -> Iterator[Problem]:
    yield from name_problems(study)
    for k, trial in enumerate(study.trials):
        yield from _choice_problems(study, trial, ("trials", k))
        yield from _option_problems(study, trial, ("trials", k), path)
    yield from _text_problems(study)
    if study.address is not None:
        if not local_server.is_origin(study.address):
            yield ("address",), f"'{study.address}' is no address; write it as https://study.example.org"


def _trial_problems(trial: Trial, loc: tuple[str | int, ...]) -> Iterator[Problem]:
    if len(trial.kinds) != 1:
        yield (
            loc,
            f"the trial '{trial.name}' has {' and '.join(trial.kinds) or 'no episode'}; "
            "give one of watch, drive, choose",
        )
        return
    if trial.name in (BEFORE, AFTER):
        yield (
            (*loc, "name"),
            f"'{trial.name}' is the name of the questions {trial.name} the trials; choose another name",
        )
    if trial.kind == "drive" and trial.view not in VIEWS:
        yield (
            (*loc, "drive", "view"),
            f"'{trial.view}' is not one of {', '.join(VIEWS)}{suggest(str(trial.view), VIEWS)}",
        )


def _choice_problems(study: Study, trial: Trial, loc: tuple[str | int, ...]) -> Iterator[Problem]:
    """Ratings of one robot that would be asked once about two."""
    if trial.kind != "choose":
        return
    if trial.questions is None and study.questions:
        yield (
            loc,
            f"the trial '{trial.name}' shows two robots, and the questions of the study are about one; "
            "add questions: [], or questions about the choice",
        )
    for k, question in enumerate(trial.questions or ()):
        if question.kind == "template":
            clause = f"'{question.name}' rates one robot, and '{trial.name}' shows two; ask it after a trial with watch"
            yield (*loc, "questions", k), clause


def _option_problems(study: Study, trial: Trial, loc: tuple[str | int, ...], path: Path) -> Iterator[Problem]:
    for k, options in enumerate(trial.episodes):
        where = (*loc, trial.kind, k) if trial.kind == "choose" else (*loc, trial.kind)
        name = options.get("name", "-")
        if not isinstance(name, str) or not name:
            yield (*where, "name"), f"{shorten(repr(name))} is no text; write a name in quotes"
            continue
        try:
            config = study.config(options, path)
        except InputError as error:
            yield where, str(error)
            continue
        key = "name" if "name" in options else "policy"
        if (size := len(options.get("name", config.policy.label))) > MAX_WORD:
            yield where, f"{key}: {size:,} characters; give the episode a name of at most {MAX_WORD:,}"


def _text_problems(study: Study) -> Iterator[Problem]:
    """Texts and numbers that the study's file, or a page, would not hold as they are."""
    places: list[tuple[tuple[str | int, ...], Any]] = [((), study.model_dump())]
    size, found = 0, False
    while places and size <= MAX_STUDY:
        loc, value = places.pop()
        if isinstance(value, dict):
            places += [((*loc, key), each) for key, each in value.items()]
            texts = [key for key in value if isinstance(key, str)]
        elif isinstance(value, list | tuple):
            places += [((*loc, k), each) for k, each in enumerate(value)]
            texts = []
        else:
            texts = [value] if isinstance(value, str) else []
            if isinstance(value, float) and not math.isfinite(value):
                found = True
                yield loc, f"{value} cannot be stored; give a finite number"
        for text in texts:
            size += len(text)
            if (wrong := wrong_character(text)) is not None:
                found = True
                yield loc, f"character {ord(wrong):04x} cannot be stored; remove it"
        if len(loc) > 1 and loc[-2] == "choices" and isinstance(value, str) and len(value) > MAX_WORD:
            yield loc, f"has {len(value):,} characters; write at most {MAX_WORD:,}"
    if size > MAX_STUDY or (not found and len(study.model_dump_json()) > MAX_STUDY):
        yield (), f"the study has more than {MAX_STUDY:,} characters, aliases as often as they are used; shorten it"


def _repeated(loc: tuple[str | int, ...], names: list[str]) -> Iterator[Problem]:
    for k, name in enumerate(names):
        if name in names[:k]:
            yield (*loc, k), f"the name '{name}' is used twice; choose another name"


# ------------------------------------------------------------------ answers


def checked(question: dict[str, Any], value: Any) -> Any:
    """An answer as it is stored; None takes it back.

    Raises:
        InputError: it is no answer to the question.
    """
    kind, name = question["kind"], question["name"]
    if value is None or value == "":
        return None
    if kind == "text" and isinstance(value, str):
        return _checked_text(name, value)
    if kind == "choice" and isinstance(value, str) and value in question["choices"]:
        return value
    if kind == "likert" and _is_finite(value) and value in range(1, question["points"] + 1):
        return int(value)
    if kind == "number" and _is_finite(value):
        low, high = question["range"] or (-math.inf, math.inf)
        if low <= value <= high:
            return value
        raise InputError(f"{name}: {value:g} must be from {low:g} to {high:g}.")
    raise InputError(f"{name}: that is no answer to this question; reload the page.")


def _is_finite(value: Any) -> TypeGuard[float]:
    """Whether it is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -sys.float_info.max <= value <= sys.float_info.max  # compares an integer of 400 digits without converting it


def _checked_text(name: str, text: str) -> str:
    """A text that all files can hold.

    Raises:
        InputError: it is too long, or has a character that is none.
    """
    if len(text) > MAX_TEXT:
        raise InputError(f"{name}: {len(text):,} characters; write at most {MAX_TEXT:,}.")
    if (wrong := wrong_character(text)) is not None:
        raise InputError(f"{name}: character {ord(wrong):04x} cannot be stored; type the text again.")
    return text


def wrong_character(text: str) -> str | None:
    """The first character of a text that not all files can hold."""
    return next((character for character in text if unicodedata.category(character) in ("Cc", "Cs")
                 and character not in LINES), None)  # fmt: skip


# ------------------------------------------------------------------ balance


def rows(count: int) -> int:
    """Participants after which all orders of so many trials have occurred."""
    return count if count % 2 == 0 or count == 1 else 2 * count


def sequence(count: int, participant: int) -> list[int]:
    """The order of the trials of a participant: each trial is as often at each place, and after each other trial.

    Source: E. Williams, "Experimental designs balanced for the estimation of residual effects of treatments",
    Australian Journal of Scientific Research 2 (1949).
    """
    row = participant % rows(count)
    zigzag = [(k + 1) // 2 if k % 2 else -(k // 2) for k in range(count)]
    order = [(row + shift) % count for shift in zigzag]
    return order[::-1] if row >= count else order
