"""Export of an agent as an ONNX model, which drives a robot without this package and without jax.

The model has one input for each part of the observation, by its name, and the outputs ``command`` and ``action``; the
statistics of the observation, its bounds and the robot's limits are inside. An agent that imitates gives its local plan
and the shares of its attention as well. ``graph_of`` translates the program that
jax traces, operation by operation, so it knows networks of the user's own as well.
"""

import json
import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Array, RobotModel
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.learning import networks
from sean_jax.learning.policy import (
    agent_folder,
    command_of,
    describe,
    describe_agent,
    last_round,
    read_agent,
    training_scenario,
)
from sean_jax.mdp import observations, to_action
from sean_jax.robots.drive import max_reverse_speed

OPSET, IR_VERSION = 18, 8  # of ONNX 1.13, which runtimes on robots know
MEMORY, NEXT_MEMORY = "memory", "next_memory"


def export(source: Path | str, out: Path | str) -> Path:
    """Write the best agent of a training, a packed agent, or one of the package as the file ``out``.

    Images are encoded in 32 bits, also those of an agent that was trained with ``bfloat16``.

    Raises:
        InputError: there is no agent, onnx is not installed, or the network has an operation that ONNX lacks.
        WriteError: the file cannot be written.
        IncompleteError: the checkpoint cannot be read.
    """
    try:
        import onnx
    except ImportError:
        raise InputError('export onnx: onnx is missing; pip install "sean_jax[export]".') from None
    folder = agent_folder(str(source), "export onnx")
    out = Path(out)
    scenario = training_scenario(folder)
    folder = last_round(folder)
    description = in_32_bits(describe(folder, scenario))
    agent = read_agent(folder, description)
    network = description.network
    space = description.space

    inputs = {name: jax.ShapeDtypeStruct(space[name].shape, jnp.float32) for name, _ in description.terms}
    if network.recurrent:
        inputs[MEMORY] = jax.ShapeDtypeStruct((network.memory_size,), jnp.float32)
    program = drive(network, agent, description.terms, scenario.robot)
    first = ["command", "action"]
    others = sorted(jax.eval_shape(program, inputs).keys() - first)
    graph = graph_of(program, inputs, [*first, *others])

    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="sean_jax")
    facts = describe_model(description.terms, space, scenario.robot, scenario.time_step, network.memory_size)
    onnx.helper.set_model_props(model, {"agent": describe_agent(folder), **facts})
    onnx.checker.check_model(model, full_check=True)
    with writing.atomic_file(out) as stream:
        stream.write(model.SerializeToString())
    return out


def in_32_bits(description: networks.AgentDescription) -> networks.AgentDescription:
    """The description with images in 32 bits, also in the encoder."""
    network = description.network.clone(bfloat16=False)
    if isinstance(network.encoder, networks.AttentionEncoder | networks.ConvEncoder):
        network = network.clone(encoder=network.encoder.clone(dtype=jnp.float32))
    return description._replace(network=network)


def drive(
    network: networks.ActorCritic, agent: networks.Agent, terms: observations.Terms, robot: RobotModel
) -> Callable[[dict[str, Array]], dict[str, Array]]:
    """The function of an observation, and of a memory, that the model computes: name -> output."""

    def program(inputs: dict[str, Array]) -> dict[str, Array]:
        observation = {name: jnp.clip(inputs[name], term.low, term.high) for name, term in terms}
        vector = jnp.pad(observations.flatten(terms, observation), (0, network.private))
        images = {name: observation[name] for name in network.images}
        memory = inputs.get(MEMORY, jnp.zeros(0, jnp.float32))
        output = networks.apply(network, agent, vector, images, memory, jnp.zeros((), bool))

        command = command_of(robot, agent, output.mean)
        action = output.mean if agent.command_scale is None else to_action(robot, command)
        results = {"command": command, "action": jnp.clip(action, -1.0, 1.0)}
        if network.recurrent:
            results[NEXT_MEMORY] = output.memory
        return results | output.auxiliary

    return program


def describe_model(
    terms: observations.Terms, space: Mapping[str, Any], robot: RobotModel, time_step: float, memory_size: int
) -> dict[str, str]:
    """Name -> text or JSON, what a model takes and gives."""
    inputs = [
        {"name": name, "shape": space[name].shape, "low": term.low, "high": term.high, "image": term.image,
         "stack": term.stack, "every": term.every, "definition": term.definition}
        for name, term in terms
    ]  # fmt: skip
    limits = {
        "name": robot.name,
        "max_speed": float(robot.max_speed),
        "max_reverse_speed": float(max_reverse_speed(robot)),
        "max_turn_rate": float(robot.max_turn_rate),
        "max_acceleration": float(robot.max_acceleration),
        "max_turn_acceleration": float(robot.max_turn_acceleration),
    }
    return {
        "observation": json.dumps(inputs),
        "frame": "the robot's: x ahead, y to the left, angles counter-clockwise; m, s, rad",
        "command": "speed ahead [m/s], turn rate to the left [rad/s], within the limits of robot",
        "action": "the same as shares of the limits, from -1 to 1",
        "robot": json.dumps(limits),
        "period": f"{time_step:g}",
        "memory": f"{MEMORY} begins with {memory_size} zeros; then it is the last {NEXT_MEMORY}" if memory_size else "",
        "versions": json.dumps(versions()),
    }


# ------------------------------------------------------------------ from jax to ONNX

UNARY = {
    "abs": "Abs", "ceil": "Ceil", "cos": "Cos", "erf": "Erf", "exp": "Exp", "floor": "Floor", "log": "Log",
    "logistic": "Sigmoid", "neg": "Neg", "not": "Not", "sign": "Sign", "sin": "Sin", "sqrt": "Sqrt", "tanh": "Tanh",
    "copy": "Identity", "copy_p": "Identity", "stop_gradient": "Identity", "reduce_precision": "Identity",
}  # fmt: skip
BINARY = {
    "add": "Add", "add_any": "Add", "and": "And", "div": "Div", "eq": "Equal", "ge": "GreaterOrEqual", "gt": "Greater",
    "le": "LessOrEqual", "lt": "Less", "max": "Max", "min": "Min", "mul": "Mul", "or": "Or", "pow": "Pow", "sub": "Sub",
    "xor": "Xor",
}  # fmt: skip
REDUCTIONS = {
    "reduce_sum": "ReduceSum", "reduce_max": "ReduceMax", "reduce_min": "ReduceMin", "reduce_prod": "ReduceProd",
    "reduce_or": "ReduceMax", "reduce_and": "ReduceMin",
}  # fmt: skip
RESHAPES = "reshape", "squeeze", "expand_dims"
CALLS = "jaxpr", "call_jaxpr", "fun_jaxpr"  # parameters of operations that hold a program


def graph_of(program: Callable[[dict[str, Array]], Any], inputs: Mapping[str, Any], outputs: Sequence[str]) -> Any:
    """The ONNX graph of a traced program of a dict of arrays, which gives a dict of arrays with these names.

    Raises:
        InputError: it has an operation that is not known here.
    """

    def flat_program(*values: Array) -> list[Array]:
        results = program(dict(zip(inputs, values, strict=True)))
        return [results[name] for name in outputs]

    closed = jax.make_jaxpr(flat_program)(*inputs.values())
    return _Translation().graph(closed, list(inputs), outputs)


class _Operation(NamedTuple):
    """An operation of a traced program."""

    values: list[Any]  # names in the graph, or numpy arrays
    shapes: list[tuple[int, ...]]  # of the values
    out: Any  # shape and type of its first result
    params: Mapping[str, Any]

    @property
    def first(self) -> Any:
        """The first value."""
        return self.values[0]

    def constant(self, number: float) -> Any:
        """A number of the type of the result."""
        return np.dtype(self.out.dtype).type(number)


def _whole(numbers: Iterable[int]) -> np.ndarray:
    """Whole numbers as ONNX has them."""
    return np.asarray([*numbers], np.int64)


class _Translation:
    """A graph in the making. A value is a name in the graph, or a numpy array if it does not depend on the inputs."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: dict[str, np.ndarray] = {}
        self.number = 0

    def graph(self, closed: Any, inputs: list[str], outputs: Sequence[str]) -> Any:
        """The graph, without what no output needs."""
        from onnx import helper, numpy_helper

        results = self.run(closed, inputs)
        for name, value in zip(outputs, results, strict=True):
            self.nodes.append(helper.make_node("Identity", [self.name(value)], [name]))
        needed = set(outputs)
        nodes = []
        for node in reversed(self.nodes):
            if needed.intersection(node.output):
                nodes.append(node)
                needed.update(node.input)
        arrays = [numpy_helper.from_array(array, name) for name, array in self.constants.items() if name in needed]
        ends = zip(inputs, closed.in_avals, strict=True), zip(outputs, closed.out_avals, strict=True)
        infos = [
            [helper.make_tensor_value_info(name, _kind(each.dtype), each.shape) for name, each in end] for end in ends
        ]
        return helper.make_graph(nodes[::-1], "policy", infos[0], infos[1], arrays)

    def run(self, closed: Any, arguments: Sequence[Any]) -> list[Any]:
        """The values of a program with its constants."""
        program = closed.jaxpr
        values = {}
        values.update(zip(program.constvars, map(np.asarray, closed.consts), strict=True))
        values.update(zip(program.invars, arguments, strict=True))
        read = lambda each: np.asarray(each.val) if hasattr(each, "val") else values[each]  # noqa: E731
        for step in program.eqns:
            results = self.step(step, [read(each) for each in step.invars])
            values.update(zip(step.outvars, results, strict=True))
        return [read(each) for each in program.outvars]

    def step(self, step: Any, values: list[Any]) -> list[Any]:
        """The values of one operation."""
        inner = next((step.params[name] for name in CALLS if name in step.params), None)
        if inner is not None and hasattr(inner, "consts") and step.primitive.name not in ("scan", "while"):
            return self.run(inner, values)
        if not any(isinstance(value, str) for value in values):
            result = step.primitive.bind(*map(jnp.asarray, values), **step.params)
            return [np.asarray(each) for each in (result if step.primitive.multiple_results else [result])]
        name = step.primitive.name
        shapes = [variable.aval.shape for variable in step.invars]
        result = self.translate(name, _Operation(values, shapes, step.outvars[0].aval, step.params))
        if result is None:
            raise InputError(
                f"export onnx: the network has the operation {name}, which is not translated; "
                "layers, convolutions, attention and elementwise functions are known."
            )
        return result if isinstance(result, list) else [result]

    def translate(self, kind: str, operation: _Operation) -> Any:
        """The value of an operation, or a list of several; None if it is not known."""
        if kind in UNARY:
            return self.node(UNARY[kind], operation.first)
        if kind in BINARY:
            return self.node(BINARY[kind], *operation.values)
        if kind in REDUCTIONS:
            return self.reduce(REDUCTIONS[kind], operation.first, operation.params["axes"], operation.out)
        if kind in RESHAPES:
            return self.reshape(operation.first, operation.out.shape)
        translator: Callable[[_Operation], Any] | None = getattr(self, f"_{kind}", None)
        return None if translator is None else translator(operation)

    # Of each operation below, the name is that of jax.

    def _ne(self, operation: _Operation) -> str:
        return self.node("Not", self.node("Equal", *operation.values))

    def _square(self, operation: _Operation) -> str:
        return self.node("Mul", operation.first, operation.first)

    def _rsqrt(self, operation: _Operation) -> str:
        return self.node("Reciprocal", self.node("Sqrt", operation.first))

    def _log1p(self, operation: _Operation) -> str:
        return self.node("Log", self.node("Add", operation.first, operation.constant(1)))

    def _expm1(self, operation: _Operation) -> str:
        return self.node("Sub", self.node("Exp", operation.first), operation.constant(1))

    def _integer_pow(self, operation: _Operation) -> str:
        return self.node("Pow", operation.first, operation.constant(operation.params["y"]))

    def _clamp(self, operation: _Operation) -> str:
        low, value, high = operation.values
        return self.node("Min", self.node("Max", value, low), high)

    def _select_n(self, operation: _Operation) -> str | None:
        if len(operation.values) != 3:
            return None
        condition, otherwise, value = operation.values
        return self.node("Where", condition, value, otherwise)

    def _convert_element_type(self, operation: _Operation) -> str:
        return self.node("Cast", operation.first, to=_kind(operation.out.dtype))

    def _broadcast_in_dim(self, operation: _Operation) -> str:
        shape = operation.out.shape
        aligned = np.ones(len(shape), int)
        aligned[list(operation.params["broadcast_dimensions"])] = operation.shapes[0]
        return self.node("Expand", self.reshape(operation.first, aligned), _whole(shape))

    def _transpose(self, operation: _Operation) -> str:
        return self.node("Transpose", operation.first, perm=list(operation.params["permutation"]))

    def _concatenate(self, operation: _Operation) -> str:
        return self.node("Concat", *operation.values, axis=operation.params["dimension"])

    def _stack(self, operation: _Operation) -> str:
        axis = operation.params["axis"]
        shape = np.insert(operation.shapes[0], axis, 1)
        return self.node("Concat", *(self.reshape(value, shape) for value in operation.values), axis=axis)

    def _tile(self, operation: _Operation) -> str:
        return self.node("Tile", operation.first, _whole(operation.params["reps"]))

    def _rev(self, operation: _Operation) -> str:
        axes = _whole(operation.params["dimensions"])
        last = np.full_like(axes, -1)
        end = np.full_like(axes, np.iinfo(np.int64).min)
        return self.node("Slice", operation.first, last, end, axes, last)

    def _split(self, operation: _Operation) -> list[str]:
        sizes = _whole(operation.params["sizes"])
        return self.nodes_of("Split", [operation.first, sizes], len(sizes), axis=operation.params["axis"])

    def _slice(self, operation: _Operation) -> str:
        params = operation.params
        dimensions = len(operation.out.shape)
        steps = params["strides"] or (1,) * dimensions
        limits = params["start_indices"], params["limit_indices"], range(dimensions), steps
        return self.node("Slice", operation.first, *map(_whole, limits))

    def _pad(self, operation: _Operation) -> str | None:
        low, high, inside = zip(*operation.params["padding_config"], strict=True)
        if min(low) < 0 or min(high) < 0 or any(inside):
            return None
        return self.node("Pad", operation.first, _whole([*low, *high]), operation.values[1])

    def _dot_general(self, operation: _Operation) -> str:
        return self.dot(operation.values, operation.shapes, operation.params["dimension_numbers"])

    def _conv_general_dilated(self, operation: _Operation) -> str | None:
        return self.convolve(operation.values, operation.params)

    def reduce(self, kind: str, value: Any, axes: Sequence[int], out: Any) -> Any:
        """A reduction; of truths by way of whole numbers."""
        truth = np.dtype(out.dtype) == np.bool_
        value = self.node("Cast", value, to=_kind(np.int32)) if truth else value
        result = self.node(kind, value, np.asarray(axes, np.int64), keepdims=0) if axes else value
        return self.node("Cast", result, to=_kind(np.bool_)) if truth else result

    def dot(self, values: list[Any], shapes: list, numbers: Any) -> str:
        """A product of matrices, or what ``Einsum`` makes of more axes."""
        (left, right), (left_batch, right_batch) = numbers
        is_last_axis = tuple(left) == (len(shapes[0]) - 1,)
        is_first_axis = tuple(right) == (0,)
        if not left_batch and is_last_axis and is_first_axis and len(shapes[1]) == 2:
            return self.node("MatMul", *values)

        # Axes that both have in common share a letter.
        letters = iter(string.ascii_letters)
        left_letters, right_letters = ([""] * len(shape) for shape in shapes)
        common_left = (*left_batch, *left)
        common_right = (*right_batch, *right)
        for left_axis, right_axis in zip(common_left, common_right, strict=True):
            left_letters[left_axis] = right_letters[right_axis] = next(letters)
        left_letters = [letter or next(letters) for letter in left_letters]
        right_letters = [letter or next(letters) for letter in right_letters]

        # The result has the batch first, then the free axes of both.
        batch = [left_letters[axis] for axis in left_batch]
        common = {left_letters[axis] for axis in common_left}
        free = [letter for letter in (*left_letters, *right_letters) if letter not in common]
        first, second, result = ("".join(row) for row in (left_letters, right_letters, [*batch, *free]))
        return self.node("Einsum", *values, equation=f"{first},{second}->{result}")

    def convolve(self, values: list[Any], params: Mapping[str, Any]) -> Any:
        """A convolution, with batch and channels first as ONNX has them."""
        if set(params["lhs_dilation"]) != {1} or params["batch_group_count"] != 1:
            return None
        order = params["dimension_numbers"]
        image, kernel = (
            self.node("Transpose", value, perm=list(axes))
            for value, axes in zip(values, (order.lhs_spec, order.rhs_spec), strict=True)
        )
        result = self.node(
            "Conv", image, kernel, strides=list(params["window_strides"]), dilations=list(params["rhs_dilation"]),
            pads=[side[end] for end in (0, 1) for side in params["padding"]], group=params["feature_group_count"],
        )  # fmt: skip
        return self.node("Transpose", result, perm=[int(axis) for axis in np.argsort(order.out_spec)])

    def reshape(self, value: Any, shape: Sequence[int] | np.ndarray) -> Any:
        """The value in another shape."""
        return self.node("Reshape", value, np.asarray(shape, np.int64))

    def node(self, kind: str, *values: Any, **attributes: Any) -> str:
        """The output of a node."""
        return self.nodes_of(kind, list(values), 1, **attributes)[0]

    def nodes_of(self, kind: str, values: list[Any], count: int, **attributes: Any) -> list[str]:
        """The outputs of a node that has several."""
        from onnx import helper

        names = [self.fresh() for _ in range(count)]
        self.nodes.append(helper.make_node(kind, [self.name(value) for value in values], names, **attributes))
        return names

    def name(self, value: Any) -> str:
        """The name of a value; a constant gets one."""
        if isinstance(value, str):
            return value
        name = self.fresh()
        self.constants[name] = np.asarray(value)
        return name

    def fresh(self) -> str:
        self.number += 1
        return f"value_{self.number}"


def _kind(dtype: Any) -> int:
    """The number by which ONNX names a type."""
    from onnx import helper

    try:
        return helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    except (KeyError, ValueError, TypeError):
        raise InputError(f"export onnx: the network has numbers of the type {dtype}; take float32.") from None
