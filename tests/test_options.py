"""Options of the commands: a command repeats them to the bit, and mistakes are told before anything is made."""

import re
import shlex
import typing
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from sean_jax import cli, drawing, options
from sean_jax import environment as environments
from sean_jax.bench import Options as Bench
from sean_jax.experiments.options import OTHERS, Experiment
from sean_jax.learning.options import Collect, Train
from sean_jax.main_job.options import Options

WORDS = ("warehouse", "-minus", "two words", "a'b", "[bold]x", ":smile:", "ümlaut", "--flag", "$HOME", "x=y", "7")


def drawn(random: np.random.Generator, kind: typing.Any) -> typing.Any:
    """A value of that type: floats of all sizes, short and long ones; words that a shell could misread."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return drawn(random, inner[0])
    if origin is typing.Literal:
        return inner[random.integers(len(inner))]
    if origin is tuple:
        kinds = [inner[0]] * int(random.integers(4)) if Ellipsis in inner else inner
        return tuple(drawn(random, each) for each in kinds)
    if type(None) in inner:
        return None if random.random() < 0.3 else drawn(random, inner[0])
    if kind is bool:
        return bool(random.random() < 0.5)
    if kind is int:
        return int(random.integers(-(2**31), 2**31))
    if kind is float:
        value = float(random.choice([-1, 1]) * 10.0 ** random.uniform(-12, 12))
        return random.choice([value, float(np.float32(value)), round(value, 2), float(round(value)), value / 3]).item()
    word = str(random.choice(WORDS))
    return Path(word) if kind is Path else word


@pytest.mark.parametrize(
    ("kind", "fixed", "loose"),
    [
        (Options, {}, ("name", "out", "quiet")),
        (Collect, {}, ("out", "quiet")),
        (Train, {"dataset": Path("runs/a b")}, ("out", "quiet")),
        (Experiment, {"which": "table1"}, ("out", "quiet", *OTHERS["table1"])),
        (Experiment, {"which": "figure4"}, ("out", "quiet", *OTHERS["figure4"])),
        (Bench, {}, ("out", "quiet")),
    ],
)
def test_the_command_gives_the_same_options_to_the_bit(kind, fixed, loose):
    random = np.random.default_rng(0)
    hints = typing.get_type_hints(kind, include_extras=True)
    for _ in range(60):
        drawn_ones = {name: drawn(random, hint) for name, hint in hints.items() if name not in loose}
        asked = kind(**{**drawn_ones, **fixed})
        words = shlex.split(asked.command)
        assert words[0] == "sean"
        assert cli._parse(words[1:]) == asked, asked.command


FOLDERS = {"file": "kept", "full/old": "kept", "map.yaml": "image: none.pgm\n"}
BAD = """
run --episodes x | --episodes; sean run --help
run --episode 3 | --episode; sean run --help
run --episodes 0 | --episodes is 0, but must lie between 1
run --episodes 99999999999 | --episodes is 99999999999, but must lie between
run --people -1 | --people is -1, but must lie between 0
run --people 1000000000 | --people is 1000000000, but must lie between
run --people 90000 | people: 90000 do not fit on a floor of 1600 m2; at most; fewer
run --batch 0 | --batch is 0, but must lie between 1
run --seed -1 | --seed is -1, but must lie between 0
run --seed 4294967296 | --seed is 4294967296, but must
run --time-limit inf | --time-limit is inf, but must lie between 0.1 and 1000000 (120 is the default)
run --time-limit nan | --time-limit is nan, but must
run --time-limit 0 | --time-limit is 0, but must
run --time-limit=-3 | --time-limit is -3, but must
run --spreading nan | --spreading is nan, but must lie between 0
run --spreading=-1 | --spreading is -1, but must
run --parties nan 0 | --parties is nan, but must lie between 0 and 1
run --parties 0.7 0.7 | parties: (0.7, 0.7); together 1 at most
run --behavior random --frame-rate 0 | --frame-rate is 0, but must
run --frame-rate 30 | frame_rate: behavior 'graph' has none; choose behavior 'playback'
run --task custom --start 1 --goal 2 2 | --start has 1 numbers; x and y
run --task custom --start nan 1 --goal 2 2 | --start is nan, but must
run --task custom | task: 'custom' needs a start and a goal
run --start 1 1 | start: task 'join_group' draws its own; choose task 'custom'
run --task join_group,custom | task: 'custom' needs a start and a goal
run --task join_group,join_grup | 'join_grup' is not one of; did you mean 'join_group'
run --task , | --task names no task; try
run --task join_group --behavior random | 'join_group' needs groups; choose task 'random_ab_nav'
run --environment warehose | environment 'warehose'; did you mean 'warehouse'
run --environment full/ | is no environment; environment.yaml
run --behavior playback | 'playback' needs a recording; give the path of a CSV file
run --behavior playback --recording nope.csv | recording: nope.csv does not exist; give the path
run --behavior playback --recording full | recording: full is no file; give the path
run --behavior playback --recording file --model orca | model: 'orca' moves nobody
run --handcrafted all | handcrafted: behavior 'graph' has no sets; choose behavior 'handcrafted'
run --behavior handcrafted --people 4 | people: 4; leave people out
run --behavior random --paths edge | paths: behavior 'random' has no graph; choose behavior 'graph'
run --paths egde | paths: 'egde' is not one of; did you mean 'edge'
run --model orka | model: 'orka' is not one of; did you mean 'orca'
run --forces helbing95 | forces: 'helbing95'; did you mean 'helbing1995'
run --situations papr | situations: 'papr'; did you mean 'paper'
run --dynamics twinn | dynamics 'twinn'; did you mean 'twin'
run --robot kurri | robot 'kurri'; did you mean 'kuri'
run --robot nope.xml | no robot file 'nope.xml'
run --policy go_to_gaol | policy: 'go_to_gaol'; did you mean 'go_to_goal'
run --policy runs/nope | policy: 'runs/nope'; sean train
run --policy full | full has no trained network; sean train imitation
run --camera first_persn | camera: robot 'kuri' has no 'first_persn'; did you mean 'first_person'
run --camera depth --renderer unity | renderer: 'unity' is not one of rays, mujoco
run --renderer mujoco | --renderer; add --camera first_person
run --out file | --out; file is a file; new folder
run --out full | --out; the folder full is not empty; new folder
run --out . | --out
run --out "" | --out is an empty text; leave the option out
run --environment= | --environment is an empty text
collect --driver nobody | --driver: 'nobody' is not one of
collect --hours 0 | --hours is 0, but must
collect --hours nan | --hours is nan, but must
collect --width 4 | --width is 4, but must lie between 8
collect --environment nope | environment 'nope' is not one of; give one of them
collect --task join_grup | 'join_grup' is not one of; did you mean
collect --behavior playback | --behavior playback is not recorded; choose behavior graph
collect --task custom | --task custom is not recorded; choose
collect --out file | file is a file
collect --out full | full; --out
train imitation nope | nope; sean collect
train imitation full --learning-rate nan | --learning-rate is nan, but must; 0.001 is the default
train imitation full --epochs 0 | --epochs is 0, but must
train imitation full --validation 1 | --validation is 1, but must
train reinforce full | reinforce; sean train --help
experiment table1 --speeds nan | --speeds is nan, but must lie between 0 and 100
experiment table1 --speeds 1.4 -1 | --speeds is -1, but must
experiment table1 --crowds -1 | --crowds is -1, but must
experiment table1 --hours 0 | --hours is 0, but must
experiment table1 --environment nope | environment 'nope' is not one of; give one of them
experiment table1 --drivers nobody | --drivers: 'nobody' is not one of
experiment table1 --drivers , | --drivers names nobody
experiment figure4 --driver nobody | --driver: 'nobody' is not one of
experiment figure4 --people 90000 | people: 90000 do not fit; fewer
experiment figure4 --out full | full; --out
experiment table3 | table3; sean experiment --help
bench --only stepp | --only: 'stepp' is not one of step
bench --batches 0 | --batches is 0, but must
bench --seconds inf | --seconds is inf, but must
bench --environment moon --only step | environment 'moon'; give one of them
bench --out full | --out; the folder full is not empty; new folder
draw | draw: give either --graph or --handcrafted
draw --graph --out full | --out: full is a folder; the name of a file
draw --graph --out "" | --out is an empty text
draw --graph --out /dev/null | --out: /dev/null is a device or a pipe; the name of a file
draw --graph --out sheet | --out: sheet has no ending; must end in one of .png
draw --graph --out sheet.docx | --out: sheet.docx ends in .docx, but must end in one of .png
draw --graph --out nope/sheet.png | there is no folder nope; make it first
draw --graph --out file/sheet.png | there is no folder file; make it first
draw --graph --environment nope | environment 'nope'; give one of them
import-map map.yaml --out full | --out; the folder full is not empty
import-map map.yaml --out file | --out; file is a file
import-map map.yaml --out new --height nan | --height is nan, but must
import-map nope.yaml --out new | nope.yaml; there is no such file
export lerobot nope --out full | --out; the folder full is not empty
export lerobot nope --out file | --out; file is a file
rn | rn; run, collect; sean --help
""".strip().splitlines()


@pytest.fixture(scope="module")
def compiled():
    """Grows by the name of everything that XLA compiles, but for changes of a number's type."""
    found = []

    def listen(event: str, duration_secs: float, **kwargs: typing.Any) -> None:
        if "backend_compile" in event and "convert_element_type" not in (name := str(kwargs.get("fun_name"))):
            found.append(name)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return found


@pytest.mark.parametrize("case", BAD, ids=[case.split(" | ")[0] for case in BAD])
def test_a_mistake_is_told_before_anything_is_made(case, compiled, capsys, monkeypatch, tmp_path):
    """In one sentence, or in the parser's own box, which name the option and the cure; nothing is compiled or left."""
    for name, text in FOLDERS.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    compiled.clear()

    def loaded(*arguments):
        raise AssertionError("the scenario was begun")

    monkeypatch.setattr(environments, "load", loaded)
    line, _, wanted = case.partition(" | ")
    boxed = False
    try:
        code = cli.main(shlex.split(line))
    except SystemExit as end:  # of the parser
        code, boxed = end.code, True
    told = capsys.readouterr().err
    assert code == 2
    said = " ".join(re.sub("[│|]", " ", told).split())
    for words in wanted.split("; "):
        assert words in said, (words, said)
    if not boxed:
        assert told.startswith("sean: ") and len(told.splitlines()) == 1 and told.rstrip().endswith((".", "?"))
    assert not compiled or "--camera" in line, "figures of a robot are staged, and nothing else is compiled"
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == sorted([*FOLDERS, "full"])


@pytest.mark.parametrize("text", ["graph.yaml:100:10: wrong", "[bold]folder[/]", "a:smile:b", "[/x]", "{task} 100%"])
@pytest.mark.parametrize("width", [40, 200])
def test_a_message_comes_out_as_it_is(text, width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    assert cli._fail(text, 2) == 2
    cli._say(Console(), "report: ", text)
    shown = capsys.readouterr()
    assert shown.err == f"sean: {text}\n" and shown.out == f"report: {text}\n"


def test_numbers_are_written_as_short_as_they_are_read_the_same():
    random = np.random.default_rng(1)
    for value in [*10.0 ** random.uniform(-300, 300, 2000), 0.1 + 0.2, 1 / 3, 120.0, 1e22, 5e-324]:
        assert float(options.written(float(value))) == value
    assert options.written(120.0) == "120" and options.written(0.1) == "0.1" and options.written(3) == "3"


def test_the_default_task_fits_the_behavior_and_the_poses():
    assert Options().tasks == ("join_group", "leave_group")
    assert Options(behavior="playback").tasks == Options(behavior="random").tasks == ("random_ab_nav",)
    assert Options(behavior="handcrafted").tasks == ("handcrafted",)
    assert Options(start=(1.0, 1.0), goal=(2.0, 2.0)).tasks == ("custom",)
    assert Options(task="join_group", behavior="random").tasks == ("join_group",)


def test_every_choice_is_explained_by_a_whole_sentence():
    from sean_jax.main_job import choices

    for option, offered in choices.offered():
        for name, line in offered.items():
            if option != "situations":
                assert line[0].isupper() and line.endswith(".") and "``" not in line, (option, name, line)
                assert len(line.split()) >= 4, (option, name, line)


def test_the_endings_of_pictures_are_those_that_matplotlib_writes(tmp_path):
    from matplotlib.figure import Figure

    for suffix in cli.PICTURES:
        options.check_file(tmp_path / f"sheet{suffix}", cli.PICTURES)
        Figure(figsize=(0.5, 0.5)).savefig(tmp_path / f"sheet{suffix}")
        assert (tmp_path / f"sheet{suffix}").stat().st_size > 0
        options.check_file(tmp_path / f"sheet{suffix.upper()}", cli.PICTURES)


@pytest.mark.parametrize(
    ("place", "said"), [("", "folder"), ("x.png", "must end in"), ("no/x.gif", "there is no folder")]
)
def test_a_gif_that_cannot_be_written_is_refused_before_it_is_drawn(place, said, scenario, tmp_path):
    nothing: typing.Any = None
    for write in (
        lambda path: drawing.animate(scenario.environment, nothing, path),
        lambda path: drawing.video(nothing, scenario, path),
    ):
        with pytest.raises(ValueError, match=said):
            write(tmp_path / place)
