"""The inverse Behavior Graph (section IV-D): from what people do, to the graph that makes them do it.

``sean fit-graph`` proposes a graph for an environment (``proposal``), measures what recorded or simulated people do on
it (``measuring``), and finds the weights, stays and speeds with which a model of flows (``flow_model``) has people do
the same (``fitting``).
"""

from sean_jax.studies.inverse_graph.command import run
from sean_jax.studies.inverse_graph.fitting import GraphFit, fit_flows, flow_error
from sean_jax.studies.inverse_graph.flow_model import FlowWeights, expected_flows, layout, weights_of
from sean_jax.studies.inverse_graph.measuring import Calls, FlowMeasure, measure_flows, people_alone, people_called
from sean_jax.studies.inverse_graph.proposal import propose

__all__ = [
    "Calls",
    "FlowMeasure",
    "FlowWeights",
    "GraphFit",
    "expected_flows",
    "fit_flows",
    "flow_error",
    "layout",
    "measure_flows",
    "people_alone",
    "people_called",
    "propose",
    "run",
    "weights_of",
]
