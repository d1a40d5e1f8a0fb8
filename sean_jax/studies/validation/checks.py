"""The table of all checks, the gates that they make up, and which of them a command does.

RiMEA guideline 4.1.1 (2025); IMO MSC.1/Circ.1533, annex; NIST Technical Note 1822 (2013); ISO 20414 (2020). Tests of
stairs, of several storeys and of disabilities are beyond people on one level, and are not in the table.
"""

from dataclasses import dataclass, replace
from functools import partial

from sean_jax.behaviors.graph_choices import MAX_WAIT
from sean_jax.errors import InputError
from sean_jax.files import listed, unknown_name
from sean_jax.studies.validation import crowds, guidelines, individuals
from sean_jax.studies.validation.check import Check

RIMEA, IMO = "RiMEA guideline 4.1.1 (2025), test", "IMO MSC.1/Circ.1533, annex, test"
NIST, ISO = "NIST Technical Note 1822 (2013), test", "ISO 20414 (2020), test"
CORNER = "A corridor 2 m wide around a corner, 12 m to its outer side and 12 m on; 20 people in the first 6 m."
CABINS = (
    "Twelve cabins of 3 by 5 m with doors of .9 m, on both sides of a corridor 1.2 m wide and open at its ends; 23 "
    "people. Those of cabins 5, 6, 11 and 12 are assigned the secondary exit, the others the main one."
)
HALL = "A hall of 30 by 20 m, 1000 people at least 2 m from its walls; doors of 1 m, 4 m from the corners."
AGES = "50 people side by side without walls; speeds by age: .58 to 1.61, 1.41 to 1.54, .68 to 1.41, .46 to .76 m/s."
COUNTER = "Two rooms of 10 by 10 m and a corridor of 10 by 2 m between them; 100 people against 0, 10, 50 and 100."
TWO_ROOMS = "Two rooms of 10 by 10 m, a passage 5 m long between them; 150 people in the first, an exit of 1 m."
FULL_ROOM = "A room of 8 by 5 m with 100 people and a door of 1 m in the middle of a 5 m wall."
TWO_EXITS = "A hall of 30 by 20 m, people in its left half, two exits of 1 m in the upper wall at 17 and 26 m."
REACTIONS = "A room of 8 by 5 m, ten people with reaction times from 10 to 100 s."
STARTS = "when each begins to walk: half of the preferred speed"
DENSITY = "mean density in squares of 2 by 2 m while the middle 60 % go through"

REACTION = Check(
    name="rimea-5",
    title="Reaction times",
    setup=REACTIONS,
    measure=STARTS,
    criterion="within .5 s of their reaction times",
    source=f"{RIMEA} 5",
    function=guidelines.reaction_times,
)
AROUND_CORNER = Check(
    name="rimea-6",
    title="Around a corner",
    setup=CORNER,
    measure="how deep bodies enter walls, and how many arrive",
    criterion="all arrive, nobody through a wall (1 mm)",
    source=f"{RIMEA} 6",
    function=guidelines.around_a_corner,
)
POPULATION = Check(
    name="rimea-7",
    title="Speeds of a population",
    setup=AGES,
    measure="free speed over 20 m",
    criterion="within .05 m/s of what each prefers",
    source=f"{RIMEA} 7",
    function=guidelines.free_speeds,
)
HALF_THE_DOORS = Check(
    name="rimea-9",
    title="Half of the doors",
    setup=HALL,
    measure="time until all are out, through four doors and through two",
    criterion="about twice as long (1.7 to 2.3 times)",
    source=f"{RIMEA} 9",
    function=guidelines.half_the_doors,
    quick=False,
)
ASSIGNED_EXITS = Check(
    name="rimea-10",
    title="Assigned exits",
    setup=CABINS,
    measure="by which exit each leaves",
    criterion="all as assigned",
    source=f"{RIMEA} 10",
    function=guidelines.assigned_exits,
)
COUNTERFLOW = Check(
    name="imo-8",
    title="Counterflow",
    setup=COUNTER,
    measure="time until the 100 are out of the corridor",
    criterion="rises with the number of people against",
    source=f"{IMO} 8",
    function=guidelines.against,
)
_ROWS = (
    Check(
        name="rimea-1",
        title="One person walks along a corridor",
        setup="A corridor of 40 by 2 m, one person who prefers 1.33 m/s.",
        measure="time for the 40 m",
        criterion="26 to 34 s",
        source=f"{RIMEA} 1",
        function=partial(guidelines.walk_time, speed=1.33, shortest=26.0, longest=34.0),
    ),
    Check(
        name="rimea-4",
        title="Speed falls with density",
        setup="A periodic corridor of 26 by 2 m with .5 to 6 people/m²; --quick: .5 to 4.",
        measure="mean speed in three squares of 2 by 2 m, 60 s after the first 10",
        criterion="falls from each density to the next, to half or less (the half is ours), and stays forward",
        source=f"{RIMEA} 4",
        function=guidelines.falling_speed,
    ),
    REACTION,
    AROUND_CORNER,
    POPULATION,
    HALF_THE_DOORS,
    ASSIGNED_EXITS,
    Check(
        name="rimea-11",
        title="Choice of an exit",
        setup=f"{TWO_EXITS} 1000 people.",
        measure="share that takes the nearer exit",
        criterion="most take the nearer, some the other (50 to 95 %)",
        source=f"{RIMEA} 11",
        function=partial(guidelines.exit_choice, numbers=(1000,), fewest=0.5, most=0.95),
        quick=False,
    ),
    Check(
        name="rimea-12",
        title="One bottleneck after another",
        setup=f"{TWO_ROOMS} Passages of .8, 1.0 and 1.2 m.",
        measure=f"flow of the middle 60 % into the passage and out; {DENSITY}",
        criterion="at most .05 people/s more come out; the queue is before the passage; flow rises with its width",
        source=f"{RIMEA} 12",
        function=guidelines.one_after_another,
    ),
    Check(
        name="rimea-14",
        title="Route choice",
        setup=f"{TWO_EXITS} 10 and 300 people, who take the exit through which they expect to be out first.",
        measure="share that takes the nearer exit",
        criterion="is documented; of 300 people some take the other (50 to 95 % the nearer)",
        source=f"{RIMEA} 14",
        function=partial(guidelines.exit_choice, numbers=(10, 300), fewest=0.5, most=0.95),
    ),
    Check(
        name="rimea-15",
        title="Wide ways, straight and around a corner",
        setup="Ways 20 m wide, 500 people in the first 6 m: 50 m, around a corner (40 and 30 m), and 81.4 m.",
        measure="time until all have arrived",
        criterion="the short way before the corner before the long way",
        source=f"{RIMEA} 15",
        function=guidelines.ways,
        quick=False,
    ),
    Check(
        name="imo-1",
        title="One person walks along a corridor",
        setup="A corridor of 40 by 2 m, one person who prefers 1 m/s and starts at rest.",
        measure="time for the 40 m",
        criterion="40 s (39 to 41)",
        source=f"{IMO} 1",
        function=partial(guidelines.walk_time, speed=1.0, shortest=39.0, longest=41.0),
    ),
    Check(
        name="imo-4",
        title="Flow through a door",
        setup=FULL_ROOM,
        measure="flow of the middle 60 %",
        criterion="1.33 people/s at most",
        source=f"{IMO} 4",
        function=guidelines.most_flow,
    ),
    replace(REACTION, name="imo-5", source=f"{IMO} 5"),
    replace(AROUND_CORNER, name="imo-6", source=f"{IMO} 6"),
    replace(POPULATION, name="imo-7", source=f"{IMO} 7"),
    COUNTERFLOW,
    replace(HALF_THE_DOORS, name="imo-9", source=f"{IMO} 9"),
    replace(ASSIGNED_EXITS, name="imo-10", source=f"{IMO} 10"),
    Check(
        name="nist-2.1",
        title="Free speed",
        setup="A corridor of 60 by 2 m, one person who prefers 1 m/s.",
        measure="speed over the middle 40 m",
        criterion="1.0 ± .05 m/s",
        source=f"{NIST} 2.1",
        function=guidelines.free_speed,
    ),
    replace(AROUND_CORNER, name="nist-2.3", source=f"{NIST} 2.3", criterion="all arrive, 1 mm at most"),
    Check(
        name="nist-2.4",
        title="Speeds of a population",
        setup="100 people side by side without walls, who prefer N(1.2, .2) m/s.",
        measure="free speed over 20 m",
        criterion="normal with that mean and deviation: Kolmogorov-Smirnov p > .05",
        source=f"{NIST} 2.4",
        function=guidelines.normal_speeds,
    ),
    replace(COUNTERFLOW, name="nist-2.8", source=f"{NIST} 2.8"),
    Check(
        name="nist-2.9",
        title="A group keeps together",
        setup="A corridor of 40 by 4 m; a walking group of four people of 1.25 m/s and one of .5 m/s.",
        measure="time between the first and the last to arrive",
        criterion="10 s at most",
        source=f"{NIST} 2.9",
        function=guidelines.group_together,
    ),
    replace(ASSIGNED_EXITS, name="nist-3.1", source=f"{NIST} 3.1"),
    Check(
        name="nist-5.1",
        title="Congestion",
        setup=f"{TWO_ROOMS} A passage of 1 m.",
        measure=DENSITY,
        criterion="people queue before the passage, not in it or behind it",
        source=f"{NIST} 5.1",
        function=guidelines.queue,
    ),
    Check(
        name="nist-5.2",
        title="Flow through a door",
        setup=FULL_ROOM,
        measure="flow of the middle 60 %",
        criterion="1.33 people/s/m at most",
        source=f"{NIST} 5.2",
        function=guidelines.most_flow,
    ),
    Check(
        name="iso-12",
        title="Flow against width",
        setup="A room of 8 by 5 m with 100 people and a door of 1.0 to 1.8 m.",
        measure="flow of the middle 60 %",
        criterion="rises with the width",
        source=f"{ISO} 12",
        function=guidelines.rising_flow,
    ),
    Check(
        name="iso-13",
        title="Speed against density",
        setup="A periodic corridor of 60 by 2 m with 60 to 480 people who prefer 1.2 m/s; --quick: 60 to 240.",
        measure="mean speed in the zone from 20 to 40 m",
        criterion="never above the free speed by more than .05 m/s",
        source=f"{ISO} 13",
        function=guidelines.slower_in_crowds,
    ),
    Check(
        name="iso-16",
        title="Two equal exits",
        setup="A room of 20 by 10 m with 200 people in its middle, an exit of 1 m in each of the short walls.",
        measure="share of both exits",
        criterion="half each, within 10 %",
        source=f"{ISO} 16",
        function=guidelines.equal_exits,
    ),
    Check(
        name="prediction",
        title="Recorded people are predicted, without collisions",
        setup="All recordings in eth_ucy of the folder of --data, in windows of 8 seen and 12 predicted moments 0.4 s "
        "apart; people go on as in their last step, without walls, by social forces with the habits of "
        "sean_jax.studies.prediction. For `calibrated`, constants and habits are those that were fitted without "
        "the scene; for any other model, its own.",
        measure="mean distance over all predicted moments (ADE) and at the last one (FDE); share of tracks in which a "
        "predicted pair comes within 0.2 m",
        criterion="ADE and FDE at most those of constant velocity and of 0.98 times it, the habit of "
        "sean_jax.studies.prediction, in every scene, and 50 times fewer collisions",
        source="A. Gupta et al., CVPR 2018; C. Schoeller et al., IEEE RA-L 5(2), 2020",
        function=individuals.prediction,
    ),
    Check(
        name="fundamental-diagram",
        title="Speed falls with density as in Juelich",
        setup="Periodic corridor of 20 by 1.8 m, 0.5 to 2.5 people/m² (without --quick 3 as well), whose free speed "
        "is 1.55 ± 0.18 m/s; 5 draws of each (2 with --quick).",
        measure="Voronoi density and speed in the middle 4 m, by PedPy, over the second half of 60 s (of 40 s with "
        "--quick)",
        criterion="means over the draws within 15 % of 1.38, 1.25, 1.02, 0.68, 0.40 m/s at 0.5, 1, 1.5, 2, 2.5 people/"
        "m², and falling",
        source="project Hermes (doi 10.34735/ped.2009.13), measured with PedPy",
        function=crowds.corridor_diagram,
    ),
    Check(
        name="weidmann",
        title="Speed falls with density as in Weidmann's formula",
        setup="Periodic corridor of 20 by 1.8 m, 0.5 to 2.5 people/m², whose free speed is N(1.34, 0.26) m/s; "
        "5 draws of each.",
        measure="Voronoi density and speed in the middle 4 m, by PedPy, over the second half of 60 s",
        criterion="means over the draws within 25 % of 1.34 (1 - exp(-1.913 (1 / density - 1 / 5.4))) m/s, and falling",
        source="U. Weidmann, Transporttechnik der Fussgänger, ETH Zürich (1993); the tolerance is ours",
        function=crowds.weidmann_diagram,
        quick=False,
    ),
    Check(
        name="rimea-16",
        title="Speed falls with density in a single file",
        setup="Loop of 32 m, 0.6 m wide, so that nobody can pass, 0.375 to 1.875 people/m, whose free speed is "
        "N(1.34, 0.26) m/s.",
        measure="mean speed over the second half of 60 s",
        criterion="between the 10th and the 90th percentile of 26 experiments, and falling",
        source="RiMEA guideline 4.1.1 (2025), test 16, with the experiments of the SingleFileComparator",
        function=crowds.single_file_diagram,
    ),
    Check(
        name="bottleneck",
        title="A crowd leaves through a door as fast as in Juelich",
        setup="100 people whose free speed is 1.55 ± 0.18 m/s in a room of 8 by 8 m, a door of 0.8 to 2.4 m in the "
        "middle of one wall; each width with 5 seeds (with --quick three widths).",
        measure="flow through the door between 20 and 80 % of the crossings",
        criterion="within 15 % of 1.9 people/s for each metre",
        source="project Hermes (doi 10.34735/ped.2009.13), uo runs; A. Seyfried et al., Transp. Sci. 43, 395 (2009)",
        function=crowds.bottleneck,
    ),
    Check(
        name="doors",
        title="One person walks through a door",
        setup="One person who prefers 1.34 m/s, 4 m before a door of 0.6 to 1.2 m, straight ahead of it and 0.3 m "
        "aside.",
        measure="whether they get through within 12 s, and their least speed on the way",
        criterion="through from 0.7 m on; from 1.0 m on never below 80 % of the free speed",
        source="doors that people pass every day; at 1.3 shoulder widths or more they lose 0.12 to 0.16 m/s: "
        "K. Wilmut & A. Barnett, as collected in robot_sf's validation",
        function=crowds.doors,
    ),
    Check(
        name="lanes",
        title="Two directions form lanes",
        setup="Periodic corridor of 10 by 3.6 m, 0.5, 1 and 1.5 people/m² in a random mix, half of them each way, "
        "whose free speed is 1.55 ± 0.18 m/s; 5 seeds (1 with --quick).",
        measure="mean over people of ((same - opposite) / n)² among the n people within 0.3 m across the corridor, "
        "along all of it, over the last 40 % of 120 s",
        criterion="0.9 or more at each density",
        source="project Hermes (doi 10.34735/ped.2009.13), bo runs: 0.97 to 1.0 over 4 m of the corridor",
        function=crowds.lanes,
    ),
    Check(
        name="pairs-head-on",
        title="Two people who meet head-on",
        setup="Two people in the open who would pass 0 to 0.3 m from each other; 7 offsets, 3 pairs of speeds.",
        measure="least distance of their middles without both radii, between moments as well",
        criterion="bodies never overlap",
        source="people walk around each other; M. Huber et al., PLoS ONE 9, e89589 (2014)",
        function=individuals.head_on,
    ),
    Check(
        name="pairs-crossing",
        title="Two people whose ways cross",
        setup="Two people in the open who would pass 0 to 0.3 m from each other; 5 angles from 45 to 135 degrees (3 "
        "with --quick), 7 offsets, 3 pairs of speeds.",
        measure="least distance of their middles without both radii, between moments as well",
        criterion="bodies never overlap",
        source="people walk around each other; M. Huber et al., PLoS ONE 9, e89589 (2014)",
        function=individuals.crossing,
    ),
    Check(
        name="passing-robot",
        title="A robot that does not react crosses people's way",
        setup="One person, preferred speed N(1.34, 0.26) m/s, and Kuri at 1 m/s at a right angle; 256 encounters (64 "
        "with --quick) in which both would pass within 0.6 m.",
        measure="least distance of the middles of both; touched: below the sum of both radii",
        criterion="touched in 5 % at most, 0.83 ± 0.27 m on average",
        source="C. Vassallo et al., Gait & Posture 51, 97 (2017)",
        function=individuals.passing_a_robot,
    ),
    Check(
        name="passing-robot-stream",
        title="A robot that does not react crosses a stream of people",
        setup="Stream 5 m wide, 0.35 people/m², preferred speed N(1.34, 0.26) m/s, and Kuri at 1 m/s across it, 64 "
        "times (16 with --quick). People count whom it would miss by less than 0.6 m if all went straight on.",
        measure="least distance of the middles of both; touched: below the sum of both radii",
        criterion="touched in 5 % at most, 0.83 ± 0.27 m on average",
        source="C. Vassallo et al., Gait & Posture 51, 97 (2017)",
        function=individuals.passing_in_a_stream,
    ),
    Check(
        name="group-occupancy",
        title="Groups last while their members change",
        setup="62 people on the Behavior Graphs of all environments (with --quick of the warehouse), 300 s, 16 "
        "episodes (with --quick 120 s, 4 episodes), no robot.",
        measure="members over capacity, share of the time with all members, stays that end; after 20 s",
        criterion="each group: 80 % of its members on average, all of them half of the time; the mean stay not below "
        f"the shortest that is drawn, nor above the mean that is drawn by more than the {MAX_WAIT:g} s of waiting",
        source="SEAN 2.0, section IV-D: groups are maintained while people move in and out",
        function=individuals.occupancy,
    ),
)
CHECKS: dict[str, Check] = {check.name: check for check in _ROWS}
"""name -> check, in the order of the table"""


@dataclass(frozen=True)
class GateRow:
    """A gate: a promise about the default crowd, kept if all of its checks pass."""

    title: str
    promise: str
    checks: tuple[str, ...]  # names, or the beginnings of names followed by *


GATES = (
    GateRow(
        "prediction, scene left out each time",
        "ADE and FDE at most those of constant velocity in every scene, with 50 times fewer collisions; below the "
        "published social-force and GAN figures",
        ("prediction*",),
    ),
    GateRow("fundamental diagram .5 to 2.5 /m²", "within 15 % of Juelich, falling", ("fundamental-diagram*",)),
    GateRow("bottleneck .8 to 2.4 m", "within 15 % of 1.9 w", ("bottleneck*",)),
    GateRow("one person, doors of .7 m and wider", "through, at least 80 % of the free speed at 1.0 m", ("doors*",)),
    GateRow("lanes at .5, 1.0, 1.5 /m²", "order of .9 or more", ("lanes*",)),
    GateRow("head-on and crossing pairs", "bodies never overlap", ("pairs*",)),
    GateRow(
        "robot that does not react, crossing at 1 m/s",
        "touched at most 5 %, clearance within .83 ± .27 m",
        ("passing-robot*",),
    ),
    GateRow("RiMEA, IMO, NIST, ISO", "all pass", ("rimea-*", "imo-*", "nist-*", "iso-*")),
    GateRow("group occupancy", "80 % on average, full 50 % of the time", ("group-occupancy*",)),
)


def select(names: str | None, quick: bool = False) -> list[Check]:
    """The checks of a command.

    Args:
        names: separated by commas; ``rimea-*`` names all that begin so; all checks if None.
        quick: leave out checks that are not quick, unless they are named in full.

    Raises:
        InputError: there is no check of a name.
    """
    if names is None:
        return [check for check in CHECKS.values() if check.quick or not quick]
    selected: set[str] = set()
    for name in listed(names) or ["nothing"]:
        matching = matches(name)
        if not matching:
            raise InputError(unknown_name("--only", name, CHECKS))
        selected |= {each for each in matching if each == name or CHECKS[each].quick or not quick}
    return [check for name, check in CHECKS.items() if name in selected]


def matches(pattern: str) -> list[str]:
    """Names of the checks of a pattern such as rimea-1 or rimea-*; none if there is no such check."""
    if pattern.endswith("*"):
        return [name for name in CHECKS if name.startswith(pattern[:-1])]
    return [pattern] if pattern in CHECKS else []
