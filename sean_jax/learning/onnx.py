"""Export of an agent as an ONNX model, which drives a robot without this package and without jax.

The model has one input for each part of the observation, by its name, and the outputs ``command`` and ``action``; the
statistics of the observation, its bounds and the robot's limits are inside. ``graph_of`` translates the program that
jax traces, operation by operation, so it knows networks of the user's own as well.
"""

import json
import string
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.config import user_parts
from sean_jax.core.data_types import Array, RobotModel
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.learning import networks
from sean_jax.learning.policy import (
    agent_folder,
    agent_network,
    agent_terms,
    describe_agent,
    load_agent,
    read_options,
)
from sean_jax.mdp import observations, registry, to_command
from sean_jax.robots.drive import max_reverse_speed
from sean_jax.simulation.scenario import reset

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
    folder, out = agent_folder(str(source), "export onnx"), Path(out)
    options = read_options(folder)
    user_parts.check_trust(options)
    scenario = registry.build(options.per_environment[0], limit=1).member.scenario  # the first floor and robot
    _, agent, terms = load_agent(folder, scenario)
    state = jax.eval_shape(lambda: reset(scenario, jax.random.key(0)))
    space = observations.space(sum(agent_terms(options), ()), scenario, state)
    network = agent_network(options.replace(bfloat16=False), space)
    program = drive(network, agent, terms, scenario.robot)
    inputs = {name: jax.ShapeDtypeStruct(space[name].shape, jnp.float32) for name, _ in terms}
    outputs = ["command", "action"]
    if network.recurrent:
        inputs[MEMORY], outputs = jax.ShapeDtypeStruct((network.memory_size,), jnp.float32), [*outputs, NEXT_MEMORY]
    graph = graph_of(program, inputs, outputs)
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="sean_jax")
    facts = describe(terms, space, scenario.robot, scenario.time_step, network.memory_size)
    onnx.helper.set_model_props(model, {"agent": describe_agent(folder), **facts})
    onnx.checker.check_model(model, full_check=True)
    with writing.atomic_file(out) as stream:
        stream.write(model.SerializeToString())
    return out


def drive(
    network: networks.ActorCritic, agent: networks.Agent, terms: observations.Terms, robot: RobotModel
) -> Callable[[dict[str, Array]], list[Array]]:
    """The function of an observation, and of a memory, that the model computes: command, action and memory."""

    def program(seen: dict[str, Array]) -> list[Array]:
        shown = {name: jnp.clip(seen[name], term.low, term.high) for name, term in terms}
        vector = jnp.pad(observations.flatten(terms, shown), (0, network.private))
        images = {name: shown[name] for name in network.images}
        memory = seen.get(MEMORY, jnp.zeros(0, jnp.float32))
        output = networks.apply(network, agent, vector, images, memory, jnp.zeros((), bool))
        results = [to_command(robot, output.mean), jnp.clip(output.mean, -1.0, 1.0), output.memory]
        return results if network.recurrent else results[:2]

    return program


def describe(
    terms: observations.Terms, space: Mapping[str, Any], robot: RobotModel, time_step: float, memory_size: int
) -> dict[str, str]:
    """Name -> text or JSON, what a model takes and gives."""
    seen = [
        {"name": name, "shape": space[name].shape, "low": term.low, "high": term.high, "image": term.image,
         "stack": term.stack, "definition": term.definition}
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
        "observation": json.dumps(seen),
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
    """The ONNX graph of a traced program of a dict of arrays, which gives a list of arrays with these names.

    Raises:
        InputError: it has an operation that is not known here.
    """
    closed = jax.make_jaxpr(lambda *values: program(dict(zip(inputs, values, strict=True))))(*inputs.values())
    return _Translation().graph(closed, list(inputs), outputs)


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
        needed, nodes = set(outputs), []
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
        program, values = closed.jaxpr, {}
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
        name, (out, *_) = step.primitive.name, step.outvars
        shapes = [each.aval.shape for each in step.invars]
        result = self.translate(name, values, shapes, out.aval, step.params)
        if result is None:
            known = "layers, convolutions, attention and elementwise functions are known"
            raise InputError(f"export onnx: the network has the operation {name}, which is not translated; {known}.")
        return result if isinstance(result, list) else [result]

    def translate(self, kind: str, values: list[Any], shapes: list, out: Any, params: Mapping[str, Any]) -> Any:
        """The value of an operation, or a list of several; None if it is not known."""
        first, others = values[0], values[1:]
        like = np.dtype(out.dtype).type
        if kind in UNARY:
            return self.node(UNARY[kind], first)
        if kind in BINARY:
            return self.node(BINARY[kind], *values)
        if kind in REDUCTIONS:
            return self.reduce(REDUCTIONS[kind], first, params["axes"], out)
        if kind in RESHAPES:
            return self.reshape(first, out.shape)
        match kind:
            case "ne":
                return self.node("Not", self.node("Equal", *values))
            case "square":
                return self.node("Mul", first, first)
            case "rsqrt":
                return self.node("Reciprocal", self.node("Sqrt", first))
            case "log1p":
                return self.node("Log", self.node("Add", first, like(1)))
            case "expm1":
                return self.node("Sub", self.node("Exp", first), like(1))
            case "integer_pow":
                return self.node("Pow", first, like(params["y"]))
            case "clamp":
                return self.node("Min", self.node("Max", others[0], first), others[1])
            case "select_n" if len(others) == 2:
                return self.node("Where", first, others[1], others[0])
            case "convert_element_type":
                return self.node("Cast", first, to=_kind(out.dtype))
            case "broadcast_in_dim":
                middle = np.ones(len(out.shape), int)
                middle[list(params["broadcast_dimensions"])] = shapes[0]
                return self.node("Expand", self.reshape(first, middle), np.asarray(out.shape, np.int64))
            case "transpose":
                return self.node("Transpose", first, perm=list(params["permutation"]))
            case "concatenate":
                return self.node("Concat", *values, axis=params["dimension"])
            case "stack":
                shape = np.insert(shapes[0], params["axis"], 1)
                return self.node("Concat", *(self.reshape(value, shape) for value in values), axis=params["axis"])
            case "tile":
                return self.node("Tile", first, np.asarray(params["reps"], np.int64))
            case "rev":
                axes = np.asarray(params["dimensions"], np.int64)
                last, end = np.full_like(axes, -1), np.full_like(axes, np.iinfo(np.int64).min)
                return self.node("Slice", first, last, end, axes, last)
            case "split":
                sizes = np.asarray(params["sizes"], np.int64)
                return self.nodes_of("Split", [first, sizes], len(sizes), axis=params["axis"])
            case "slice":
                ends, steps = params["limit_indices"], params["strides"] or (1,) * len(out.shape)
                limits = params["start_indices"], ends, range(len(out.shape)), steps
                return self.node("Slice", first, *(np.asarray([*each], np.int64) for each in limits))
            case "pad" if all(low >= 0 and high >= 0 and inside == 0 for low, high, inside in params["padding_config"]):
                sides = [[side[end] for side in params["padding_config"]] for end in (0, 1)]
                return self.node("Pad", first, np.asarray(sum(sides, []), np.int64), others[0])
            case "dot_general":
                return self.dot(values, shapes, params["dimension_numbers"])
            case "conv_general_dilated":
                return self.convolve(values, params)
        return None

    def reduce(self, kind: str, value: Any, axes: Sequence[int], out: Any) -> Any:
        """A reduction; of truths by way of whole numbers."""
        truth = np.dtype(out.dtype) == np.bool_
        value = self.node("Cast", value, to=_kind(np.int32)) if truth else value
        result = self.node(kind, value, np.asarray(axes, np.int64), keepdims=0) if axes else value
        return self.node("Cast", result, to=_kind(np.bool_)) if truth else result

    def dot(self, values: list[Any], shapes: list, numbers: Any) -> Any:
        """A product of matrices, or what ``Einsum`` makes of more axes."""
        (left, right), (left_batch, right_batch) = numbers
        if not left_batch and tuple(left) == (len(shapes[0]) - 1,) and tuple(right) == (0,) and len(shapes[1]) == 2:
            return self.node("MatMul", *values)
        letters = iter(string.ascii_letters)
        names: list[list[str]] = [[""] * len(shape) for shape in shapes]
        for one, other in (*zip(left_batch, right_batch, strict=True), *zip(left, right, strict=True)):
            names[0][one] = names[1][other] = next(letters)
        for name in names:
            name[:] = [each or next(letters) for each in name]
        batch = [names[0][axis] for axis in left_batch]
        used = {*batch, *(names[0][axis] for axis in left)}
        result = [*batch, *(each for name in names for each in name if each not in used)]
        words = ["".join(each) for each in (*names, result)]
        return self.node("Einsum", *values, equation=f"{words[0]},{words[1]}->{words[2]}")

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
