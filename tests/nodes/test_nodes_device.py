"""A node that asks for a GPU computes there, and the other way round: else a run waits for a GPU that stays idle."""

import pytest

from exmesh_graph.graph.declare.packs import load_packs
from exmesh_graph.graph.declare.ports import signature

BUILTIN = {name: d for name, d in load_packs().types.items() if d.function.__module__.startswith("exmesh_nodes.")}


@pytest.mark.parametrize("name", BUILTIN)
def test_who_asks_for_a_gpu_has_a_parameter_for_it(name):
    asks = any(resource.startswith("gpu") for resource in BUILTIN[name].resources)
    assert asks == ("device" in signature(BUILTIN[name]).params.model_fields)
