"""Options of the commands: a command repeats them to the bit, and mistakes are told before anything is made."""

import re
import shlex
import typing
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from sean_jax import config, drawing
from sean_jax.cli import command_line, commands
from sean_jax.config import (
    COMMANDS,
    CollectConfig,
    Config,
    Number,
    RunConfig,
    ScenarioConfig,
    family_of,
    flags,
)  # fmt: skip
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.world import environment as environments
from support.files import write_all

WORDS = ("warehouse", "-minus", "two words", "a'b", "[bold]x", ":smile:", "ümlaut", "--flag", "$HOME", "x=y", "7")


def drawn(random: np.random.Generator, kind: typing.Any) -> typing.Any:
    """A value of that type: floats of all sizes, short and long ones; words that a shell could misread."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        limits = [each for each in inner[1:] if isinstance(each, Number)]
        return number(random, inner[0], limits[0]) if limits else drawn(random, inner[0])
    if origin is typing.Literal:
        return inner[random.integers(len(inner))]
    if origin is tuple:
        kinds = [inner[0]] * int(random.integers(1, 4)) if Ellipsis in inner else inner
        return tuple(drawn(random, each) for each in kinds)
    if type(None) in inner:
        return None if random.random() < 0.3 else drawn(random, inner[0])
    if kind is bool:
        return bool(random.random() < 0.5)
    word = str(random.choice(WORDS))
    return Path(word) if kind is Path else word


def number(random: np.random.Generator, kind: type, limits: Number) -> typing.Any:
    """A number within the limits, of any size."""
    if kind is int:
        return int(random.integers(int(limits.low), int(limits.high) + 1))
    value = float(random.uniform(limits.low, limits.high)) * float(10.0 ** random.uniform(-12, 0))
    value = random.choice([value, float(np.float32(value)), round(value, 2), value / 3]).item()
    return min(max(value, limits.low), limits.high)


def described(random: np.random.Generator, model: type[Config]) -> dict[str, typing.Any]:
    """Fields of a description, drawn; components are one of their family, with options of their own."""
    values: dict[str, typing.Any] = {}
    for name, hint in typing.get_type_hints(model, include_extras=True).items():
        if name not in model.model_fields:
            continue
        family = family_of(model.model_fields[name])
        if family is None:
            values[name] = drawn(random, hint)
            continue
        variant = family.variants[random.integers(len(family.variants))]
        if variant is config.CustomTask:
            values[name] = config.CustomTask(start=(1.0, 2.0), goal=(0.1, 1 / 3, 90.0))
            continue
        options = typing.get_type_hints(variant, include_extras=True)
        chosen = {key: drawn(random, options[key]) for key in variant.model_fields if key != "kind"}
        default = variant.model_fields["kind"].default
        kind = default if isinstance(default, str) else str(random.choice(["kuri", "my.py:f"]))
        values[name] = variant(kind=kind, **chosen)
    return values


FITTING = {"thresholds": None, "task_distance": (1.0, 2.0), "time_step": 0.1, "time_limit": 3.5, "metrics": "all"}


@pytest.mark.parametrize(
    ("word", "fixed"),
    [
        ("run", {**FITTING, "camera": None, "live": False, "robots": None}),
        (
            "collect",
            {**FITTING, "behavior": "random", "task": None, "width": 30, "height": 20, "metrics": (), "rate": 5},
        ),
        ("train imitation", {"dataset": Path("runs/a b"), "part": (2, 3)}),
        ("experiment table1", {"seeds": 7}),
        ("experiment figure4", {}),
        ("experiment learning_curve", {}),
        ("bench", {"only": "step,crowd"}),
        ("validate", {"only": "rimea-*", "models": "sean2,my.py:f", "data": Path("a b")}),
    ],
)
def test_the_command_gives_the_same_description_to_the_bit(word, fixed):
    random, model, word = np.random.default_rng(0), COMMANDS[word], word.split()[0]
    for _ in range(60):
        values = {**described(random, model), **fixed}
        asked = model(**values)
        words = shlex.split(flags.command(word, asked))
        assert words[:2] == ["sean", word]
        read = flags.read(model, flags.parse(word, model, words[2:], word == "run"))
        assert decisive(read) == decisive(asked), flags.command(word, asked)


def decisive(description: Config) -> dict[str, typing.Any]:
    """All that has a place in the command."""
    fields = type(description).model_fields
    names = {name for name, field in fields.items() if config.Option.of(field).affects_results}
    return description.model_dump(include=names)


def test_an_option_stands_in_one_place():
    """Every option of every command has a flag, a default or is required, and a sentence that explains it."""
    for model in COMMANDS.values():
        for name, field in model.model_fields.items():
            assert field.description and field.description.strip().endswith("."), (model, name)
            for variant in (family_of(field) or config.Family(())).variants:
                for option, about in variant.model_fields.items():
                    assert option == "kind" or (about.description or "").endswith("."), (variant, option)
    assert set(RunConfig.model_fields) > set(ScenarioConfig.model_fields) < set(CollectConfig.model_fields)


FOLDERS = {"file": "kept", "full/old": "kept", "map.yaml": "image: none.pgm\n"}
FOLDERS |= {"odd.py": "number = 3\ndef sonar(scenario, state):\n    return 0.0\n"}
BAD = """
run --episodes x | --episodes; sean run --help
run --episode 3 | --episode; sean run --help
run --episodes 0 | --episodes: 0 must be from 1
run --episodes 99999999999 | --episodes: 99999999999 must be from
run --people -1 | --people: -1 must be from 0 to 100,000
run --people 1000000000 | --people: 1000000000 must be from
run --people 90000 | people: 90000 do not fit on a floor of 1600 m2; at most; fewer
run --batch 0 | --batch: 0 must be from 1
run --seed -1 | --seed: -1 must be from 0
run --seed 4294967296 | --seed: 4294967296 must be
run --time-limit inf | --time-limit: inf must be from 0.1 to 86,400 s
run --time-limit nan | --time-limit: nan must be
run --time-limit 0 | --time-limit: 0.0 must be
run --time-limit=-3 | --time-limit: -3.0 must be
run --congestion-cost nan | --congestion-cost: nan must be from 0
run --congestion-cost=-1 | --congestion-cost: -1.0 must be
run --walking-groups nan 0 | --walking-groups: nan must be from 0 to 1
run --walking-groups 0.7 0.7 | walking_groups: (0.7, 0.7); together 1 at most
run --behavior playback --frame-rate 0 | --frame-rate: 0.0 must be
run --frame-rate 30 | --frame-rate: behavior 'graph' has no such option; choose behavior 'playback'
run --task custom --start 1 --goal 2 2 | --start: has 1 numbers; x and y
run --task custom --start nan 1 --goal 2 2 | --start: nan must be
run --task custom | task: 'custom' needs a start and a goal
run --start 1 1 | --start: the default task has no such option; choose task 'custom'
run --task join_group,custom | task: 'custom' needs a start and a goal
run --task join_group,join_grup | 'join_grup' is not one of; did you mean 'join_group'
run --task , | --task: names nothing; sean list
run --task join_group --behavior random | 'join_group' needs groups; choose task 'random_ab_nav'
run --environment warehose | environment 'warehose'; did you mean 'warehouse'
run --environment full/ | is no environment; environment.yaml
run --behavior playback | 'playback' needs a recording; give the path of a CSV file
run --behavior playback --recording nope.csv | recording: nope.csv does not exist; give the path
run --behavior playback --recording full | recording: full is no file; give the path
run --behavior playback --recording file --model orca | model: 'orca' moves nobody
run --sets all | --sets: behavior 'graph' has no such option; choose behavior 'handcrafted'
run --behavior handcrafted --people 4 | people: 4; leave people out
run --behavior random --routing edge | --routing: behavior 'random' has no such option; choose behavior 'graph'
run --routing egde | --routing: 'egde' is not one of; did you mean 'edge'
run --behavior grph | 'grph'; did you mean 'graph'
run --model orka | model: 'orka' is not one of; did you mean 'orca'
run --forces helbing95 | forces: 'helbing95'; did you mean 'helbing1995'
run --situations papr | situations: 'papr'; did you mean 'paper'
run --dynamics twinn | --dynamics: 'twinn'; did you mean 'twin'
run --robot kurri | robot 'kurri'; did you mean 'kuri'
run --robot nope.xml | no robot file 'nope.xml'
run --policy go_to_gaol | policy: 'go_to_gaol'; did you mean 'go_to_goal'
run --policy runs/nope | policy: 'runs/nope'; sean train
run --policy full | full has no trained network; sean train imitation
run --camera first_persn | camera: robot 'kuri' has no 'first_persn'; did you mean 'first_person'
run --out file | --out; file is a file; new folder
run --out full | --out; the folder full is not empty; new folder
run --out file/run | cannot write
run --out . | --out
run --out "" | --out is an empty text; leave the option out
run --environment= | --environment is an empty text
collect --policy nobody | policy: 'nobody' is not one of
collect --hours 0 | --hours: 0.0 must be
collect --hours nan | --hours: nan must be
collect --width 4 | --width: 4 must be from 8
collect --environment nope | environment 'nope' is not one of; give one of them
collect --task join_grup | 'join_grup' is not one of; did you mean
collect --behavior playback | --behavior: playback is not recorded; choose behavior graph
collect --task custom | --task: custom is not recorded; choose
collect metrics=all | --metrics: nothing is measured while demonstrations are recorded; leave the option out
collect --out file | file is a file
collect --out full | full; --out
bridge --rosbridge --address nohost | --address: nohost is no address and port; give one such as 127.0.0.1:9090
bridge --rosbridge --address 127.0.0.1:70000 | --address: 127.0.0.1:70000 is no address and port
train imitation nope | nope; sean collect
train imitation full --learning-rate nan | --learning-rate: nan must be
train imitation full --epochs 0 | --epochs: 0 must be
train imitation full --validation 1 | --validation: 1.0 must be
train reinforce full | reinforce; sean train --help
collect --rate 0 | --rate: 0 must be from 1
collect --rate 3 | rate: 3 examples a second do not divide its 10 steps of control; choose a divisor
experiment table1 --speeds nan | --speeds: nan must be from 0 to 100
experiment table1 --speeds 1.4 -1 | --speeds: -1.0 must be
experiment table1 --crowds -1 | --crowds: -1 must be
experiment table1 --hours 0 | --hours: 0.0 must be
experiment table1 --hours 0.001 | --hours: 0.001 must be from 0.0166
experiment table1 --seeds 0 | --seeds: 0 must be from 1
experiment table1 --time-limit 0 | --time-limit: 0.0 must be from 0.1
experiment table1 --robot nope | robot 'nope'
experiment table1 --environment nope | environment 'nope' is not one of; give one of them
experiment table1 --policies nobody | --policies: 'nobody' is not one of
experiment table1 --policies , | --policies names no policy
experiment figure4 --demonstrator nobody | policy: 'nobody' is not one of
experiment figure4 --environment nope | environment 'nope' is not one of; give one of them
experiment figure4 --people 90000 | people: 90000 do not fit; fewer
experiment figure4 --out full | full; --out
experiment learning_curve --demonstrator nobody | policy: 'nobody' is not one of
experiment learning_curve --demonstration-hours 1 0 | --demonstration-hours: 0.0 must be
experiment table1 --baselines ppo | --baselines; sean experiment --help
experiment learning_curve --rates 5 3 | rate: 3 examples a second do not divide its 10 steps of control
experiment table3 | 'table3' is not one of table1; did you mean 'table1'
experiment zebra | 'zebra' is not one of table1; sean experiment --help
bench --only stepp | --only: 'stepp' is not one of step
bench --only "" | --only is an empty text
bench --batches 0 | --batches: 0 must be
bench --repeats 0 | --repeats: 0 must be from 1
bench --seconds inf | --seconds: inf must be
bench --environment moon --only step | environment 'moon'; give one of them
bench --out full | --out; the folder full is not empty; new folder
validate --only rimea-99 | --only: 'rimea-99' is not one of
validate --models nobody | model: 'nobody' is not one of
validate --models nope.py:f | nope.py
validate --data nope | --data: nope is no folder
validate --only rimea-1 --out full | full holds something else; --out
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
import-map map.yaml --out new --height nan | --height: nan must be
import-map full/old --out new | old
import-map nope.yaml --out new | nope.yaml; there is no such file
import-robot nope.urdf --out new.xml | nope.urdf; there is no such file
import-robot full/old --out new.xml | old
import-robot nope.urdf --out sheet.docx | --out: sheet.docx ends in .docx, but must end in one of .xml
import-robot nope.urdf --out nope/new.xml | there is no folder nope; make it first
import-robot nope.urdf --out new.xml --mass nan | --mass: nan must be
export lerobot nope --out full | --out; the folder full is not empty
export lerobot full --out new | full
export lerobot nope --out file | --out; file is a file
export agent nope --out full | --out; the folder full is not empty
export agent nope --out new | nope has no trained agent; sean train ppo
export onnx ppo --out sheet | --out: sheet has no ending; must end in one of .onnx
export onnx ppo --out nope/agent.onnx | there is no folder nope; make it first
train ppo --environment lab --network atention | network: 'atention' is not one of; did you mean 'attention'
train ppo --environment lab --network conv | network: conv is for images; add one
train ppo --environment lab --costs colision_with_obstacle=1 | costs: 'colision_with_obstacle'; did you mean
train ppo --environment lab --costs progress=1 | costs: progress is a potential; choose a term of each step
train ppo --costs time | --costs: time has no limit above 0 per minute; write time=0.1
train ppo --distribution squash | --distribution: 'squash' is not; did you mean
train ppo --environment lab,nope | environment 'nope' is not one of; give one of them
train ppo --environment lab,lab | --environment: 'lab' is listed twice; list it once
train ppo --pretrained nope | nope has no trained agent; sean train ppo
train ppo --imitate nope | imitate: 'nope' is not one of
train ppo --observations goal,gaol | observations: 'gaol' is not one of; did you mean 'goal'
train ppo --critic goall | critic: 'goall' is not one of; did you mean 'goal'
train ppo --rewards progress,progress | --rewards: 'progress' is listed twice; list it once
train ppo --rewards progres | rewards: 'progres' is not one of; did you mean 'progress'
train ppo --terminations colision | terminations: 'colision' is not one of; did you mean 'collision'
train ppo --termination nope.py:fall | terminations: ; nope.py: there is no such file
train ppo --randomization people | randomization: 'people' is not one of behavior
train ppo --randomization bounds | randomization: there are no bounds; give some
train ppo --randomization nope.yaml | nope.yaml; there is no such file
train ppo --laws calibrated,orka --environment lab | laws: 'orka' is not one of; did you mean 'orca'
train ppo --laws calibrated,orca --forces sean2 | laws: calibrated,orca would replace the option forces; leave one
train ppo --observation-delay gaol=1 | observation_delay: 'gaol' is not one of; did you mean 'goal'
train ppo --observation-delay goal=3:1 | --observation-delay: goal=3:1 has no steps from 0 to 1,000; the least first
train ppo --action-delay 3 1 | --action-delay: 3 is more than 1; give the least steps first
train ppo --action-delay -1 1 | --action-delay: -1 must be from 0 to 1,000 steps
train ppo --sweep clip=0.1,0.1 | --sweep: clip=0.1,0.1 has a number twice
train ppo --sweep clip=0.1 clip=0.2 | --sweep: 'clip' is listed twice; with all of its numbers
train ppo --seed 4294967295 --seeds 2 | --seeds: 2 consecutive seeds from 4294967295
experiment table1 --seed 4294967295 --seeds 2 | --seed: 2 consecutive seeds from 4294967295
train ppo --num-envs 8 | --num-envs: there is no such option; did you mean '--scenarios'
train apg --total_timesteps=100 | --total_timesteps: there is no such option; did you mean '--steps'
run --num-episodes 8 | --num-episodes: there is no such option; did you mean '--episodes'
run --situations paper,paper | --situations: 'paper' is listed twice
run --task join_group,join_group | --task: 'join_group' is listed twice
experiment table1 --policies expert,expert | --policies: 'expert' is listed twice
validate --only rimea-1,rimea-1 | --only: 'rimea-1' is listed twice
bench --only step,step | --only: 'step' is listed twice
run --sensors depht | sensors: 'depht' is no sensor; did you mean 'depth'
run --sensors depth,depth | --sensors: 'depth' is listed twice
run --sensor odd.py:sonar | sensors: sonar is no Sensor; give one of
run --sensor odd.py:number | sensors: 3 is no Sensor; give one of
rn | 'rn' is not one of run, collect; did you mean 'run'
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
    monkeypatch.chdir(write_all(tmp_path, FOLDERS))
    compiled.clear()

    def loaded(*arguments):
        raise AssertionError("the scenario was begun")

    monkeypatch.setattr(environments, "load", loaded)
    line, _, wanted = case.partition(" | ")
    boxed = False
    try:
        code = command_line.main(shlex.split(line))
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
    assert commands.fail(text, 2) == 2
    commands._print(Console(), "report: ", text)
    shown = capsys.readouterr()
    assert shown.err == f"sean: {text}\n" and shown.out == f"report: {text}\n"


def test_numbers_are_written_as_short_as_they_are_read_the_same():
    random = np.random.default_rng(1)
    for value in [*10.0 ** random.uniform(-300, 300, 2000), 0.1 + 0.2, 1 / 3, 120.0, 1e22, 5e-324]:
        assert float(flags.number(float(value))) == value
    assert flags.number(120.0) == "120" and flags.number(0.1) == "0.1" and flags.number(3) == "3"


def test_the_default_task_fits_the_behavior_and_the_poses():
    def tasks(**values):
        return tuple(task.kind for task in config.validate(RunConfig, config.gather(RunConfig, values)).tasks)

    assert tasks() == ("join_group", "leave_group")
    assert tasks(behavior="playback") == tasks(behavior="random") == ("random_ab_nav",)
    assert tasks(behavior="handcrafted") == ("handcrafted",)
    assert tasks(start=(1.0, 1.0), goal=(2.0, 2.0)) == ("custom",)
    assert tasks(task="join_group", behavior="random") == ("join_group",)
    assert tasks(task="join_group, leave_group") == tasks(task=["join_group", {"kind": "leave_group"}])


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"people": True}, "people: True is not a whole number."),
        ({"people": 1.5}, "people: 1.5 is not a whole number."),
        ({"time_step": "x"}, "time_step: 'x' is not a number."),
        ({"episods": 3}, "'episods' is not a known key; did you mean 'episodes'?"),
        (
            {"behavior": {"kind": "graph", "rooting": "edge"}},
            "behavior: 'rooting' is not a known key; did you mean 'routing'?",
        ),
        ({"behavior": {"routing": "edge"}}, "behavior: {'routing': 'edge'} has no kind; there are graph, random"),
        ({"task_distance": (4.0, 2.0)}, "task_distance: (4.0, 2.0) must be a shorter and a longer distance"),
        ({"policy": 3}, "policy: 3 is no name; give one of `sean list`, or a mapping with a kind."),
        ({"behavior": None}, "behavior: an empty value names nothing; leave the option out for its default."),
        ({"behavior": ["graph", "random"]}, "behavior: ['graph', 'random'] is no name; give one of `sean list`"),
        ({"task": ["join_group", 5]}, "task: 5 is no name; give one of `sean list`"),
        ({"forces": [{"strength": 3}]}, "forces: {'strength': 3} has no kind; give one of `sean list`."),
        ({"time_limit": None}, "time_limit: an empty value is not a number."),
        ({"seed": -1}, "seed: -1 must be from 0 to 4,294,967,295."),
    ],
)
def test_a_mistake_in_a_description_is_told_in_a_sentence(values, text):
    with pytest.raises(InputError) as caught:
        config.validate(RunConfig, values)
    assert str(caught.value).startswith(text)
    with pytest.raises(InputError) as caught:
        RunConfig(**values)
    assert str(caught.value).startswith(text)


def test_names_in_a_list_are_names_with_commas_between_them():
    """Where several names are one text."""
    several = {"robots": ["kuri", "jackal"], "policy": ["expert", "orca"]}
    assert config.validate(RunConfig, several) == RunConfig(robots="kuri,jackal", policy="expert,orca")
    floors = {"environment": ["lab", "warehouse"]}
    assert config.validate(config.PPOConfig, floors) == config.PPOConfig(environment="lab,warehouse")


def test_names_of_other_projects_lead_to_an_option():
    used = set()
    for words, model in COMMANDS.items():
        word = words.split()[0]
        known = [option.name for option in flags.flags_of(model)]
        for option in set(known) & set(config.aliases()):
            used.add(option)
            for other in set(config.aliases()[option]) - set(known):
                with pytest.raises(
                    InputError, match=rf"^{flags.flag(other)}: there is no such option; did you mean '--"
                ):
                    flags.parse(word, model, [flags.flag(other), "3"])
                if option in model.model_fields and not any(f.is_required() for f in model.model_fields.values()):
                    with pytest.raises(InputError, match=f"'{other}' is not a known key; did you mean '"):
                        model(**{other: 3})
    assert used == set(config.aliases())


def test_numbers_of_numpy_are_numbers():
    asked = ScenarioConfig(people=np.int64(5), time_limit=np.float32(2.5), task_distance=(np.float64(1), 2))
    assert asked.people == 5 and asked.time_limit == 2.5 and type(asked.people) is int


def test_every_choice_is_explained_by_a_whole_sentence_of_its_own():
    from sean_jax.evaluation import list_command

    for option, offered in list_command.choices():
        assert len(set(offered.values())) == len(offered), option
        for name, line in offered.items():
            assert line[0].isupper() and line.endswith(".") and "``" not in line, (option, name, line)
            assert len(line.split()) >= 4, (option, name, line)


def test_the_endings_of_pictures_are_those_that_matplotlib_writes(tmp_path):
    from matplotlib.figure import Figure

    for suffix in commands.PICTURES:
        writing.check_file(tmp_path / f"sheet{suffix}", commands.PICTURES)
        Figure(figsize=(0.5, 0.5)).savefig(tmp_path / f"sheet{suffix}")
        assert (tmp_path / f"sheet{suffix}").stat().st_size > 0
        writing.check_file(tmp_path / f"sheet{suffix.upper()}", commands.PICTURES)


@pytest.mark.parametrize(
    ("place", "said"), [("", "folder"), ("x.png", "must end in"), ("no/x.gif", "there is no folder")]
)
def test_a_gif_that_cannot_be_written_is_refused_before_it_is_drawn(place, said, tmp_path):
    nothing: typing.Any = None
    for write in (drawing.animate, drawing.video):
        with pytest.raises(ValueError, match=said):
            write(nothing, nothing, tmp_path / place)
