"""The tests of four guidelines, as one table: RiMEA, IMO, NIST and ISO, for people on one level.

RiMEA guideline 4.1.1 (2025); IMO MSC.1/Circ.1533, annex; NIST Technical Note 1822 (2013); ISO 20414 (2020). Tests of
stairs, of several storeys and of disabilities are beyond people on one level, and are not in the table.
"""

from functools import partial

from sean_jax.studies.validation import guidelines
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

CHECKS = (
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
    Check(
        name="rimea-5",
        title="Reaction times",
        setup=REACTIONS,
        measure=STARTS,
        criterion="within .5 s of their reaction times",
        source=f"{RIMEA} 5",
        function=guidelines.reaction_times,
    ),
    Check(
        name="rimea-6",
        title="Around a corner",
        setup=CORNER,
        measure="how deep bodies enter walls, and how many arrive",
        criterion="all arrive, nobody through a wall (1 mm)",
        source=f"{RIMEA} 6",
        function=guidelines.around_a_corner,
    ),
    Check(
        name="rimea-7",
        title="Speeds of a population",
        setup=AGES,
        measure="free speed over 20 m",
        criterion="within .05 m/s of what each prefers",
        source=f"{RIMEA} 7",
        function=guidelines.kept_speeds,
    ),
    Check(
        name="rimea-9",
        title="Half of the doors",
        setup=HALL,
        measure="time until all are out, through four doors and through two",
        criterion="about twice as long (1.7 to 2.3 times)",
        source=f"{RIMEA} 9",
        function=guidelines.half_the_doors,
        quick=False,
    ),
    Check(
        name="rimea-10",
        title="Assigned exits",
        setup=CABINS,
        measure="by which exit each leaves",
        criterion="all as assigned",
        source=f"{RIMEA} 10",
        function=guidelines.assigned_exits,
    ),
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
    Check(
        name="imo-5",
        title="Reaction times",
        setup=REACTIONS,
        measure=STARTS,
        criterion="within .5 s of their reaction times",
        source=f"{IMO} 5",
        function=guidelines.reaction_times,
    ),
    Check(
        name="imo-6",
        title="Around a corner",
        setup=CORNER,
        measure="how deep bodies enter walls, and how many arrive",
        criterion="all arrive, nobody through a wall (1 mm)",
        source=f"{IMO} 6",
        function=guidelines.around_a_corner,
    ),
    Check(
        name="imo-7",
        title="Speeds of a population",
        setup=AGES,
        measure="free speed over 20 m",
        criterion="within .05 m/s of what each prefers",
        source=f"{IMO} 7",
        function=guidelines.kept_speeds,
    ),
    Check(
        name="imo-8",
        title="Counterflow",
        setup=COUNTER,
        measure="time until the 100 are out of the corridor",
        criterion="rises with the number of people against",
        source=f"{IMO} 8",
        function=guidelines.against,
    ),
    Check(
        name="imo-9",
        title="Half of the doors",
        setup=HALL,
        measure="time until all are out, through four doors and through two",
        criterion="about twice as long (1.7 to 2.3 times)",
        source=f"{IMO} 9",
        function=guidelines.half_the_doors,
        quick=False,
    ),
    Check(
        name="imo-10",
        title="Assigned exits",
        setup=CABINS,
        measure="by which exit each leaves",
        criterion="all as assigned",
        source=f"{IMO} 10",
        function=guidelines.assigned_exits,
    ),
    Check(
        name="nist-2.1",
        title="Free speed",
        setup="A corridor of 60 by 2 m, one person who prefers 1 m/s.",
        measure="speed over the middle 40 m",
        criterion="1.0 ± .05 m/s",
        source=f"{NIST} 2.1",
        function=guidelines.free_speed,
    ),
    Check(
        name="nist-2.3",
        title="Around a corner",
        setup=CORNER,
        measure="how deep bodies enter walls, and how many arrive",
        criterion="all arrive, 1 mm at most",
        source=f"{NIST} 2.3",
        function=guidelines.around_a_corner,
    ),
    Check(
        name="nist-2.4",
        title="Speeds of a population",
        setup="100 people side by side without walls, who prefer N(1.2, .2) m/s.",
        measure="free speed over 20 m",
        criterion="normal with that mean and deviation: Kolmogorov-Smirnov p > .05",
        source=f"{NIST} 2.4",
        function=guidelines.normal_speeds,
    ),
    Check(
        name="nist-2.8",
        title="Counterflow",
        setup=COUNTER,
        measure="time until the 100 are out of the corridor",
        criterion="rises with the number of people against",
        source=f"{NIST} 2.8",
        function=guidelines.against,
    ),
    Check(
        name="nist-2.9",
        title="A group keeps together",
        setup="A corridor of 40 by 4 m; a walking group of four people of 1.25 m/s and one of .5 m/s.",
        measure="time between the first and the last to arrive",
        criterion="10 s at most",
        source=f"{NIST} 2.9",
        function=guidelines.group_together,
    ),
    Check(
        name="nist-3.1",
        title="Assigned exits",
        setup=CABINS,
        measure="by which exit each leaves",
        criterion="all as assigned",
        source=f"{NIST} 3.1",
        function=guidelines.assigned_exits,
    ),
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
)
