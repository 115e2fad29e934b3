"""The transport and stage2 nodes, called as the graph calls them."""

import pytest
import torch
from exmesh_nodes import stage2, transport
from pydantic import ValidationError

from exmesh_graph.errors import MissingLibraryError
from exmesh_graph.shading.settings import BounceSettings, MonteCarloSettings, TransportSettings
from exmesh_graph.testing import FakeContext
from exmesh_graph.types import Asset, Metrics


def test_the_chain_of_nodes(carrier, train_views, tmp_path):
    ctx = FakeContext(node="pbr", seed=5)
    light = transport.direct(ctx, carrier, p=TransportSettings(directions=64, points=1200)).transport
    assert light.facets() == {"bounces": 0}
    assert len(light.points) >= 1200
    lit = transport.bounce(ctx, light, p=BounceSettings(bounces=2)).transport
    assert lit.facets() == {"bounces": 2}
    ctx.steps.clear()
    p = stage2.FitParams(iterations=12, environment_height=16, corrections=1, correction_samples=2)
    asset, history = stage2.fit(ctx, carrier, train_views, lit, p=p)
    assert isinstance(asset, Asset)
    assert ctx.steps[-1] == (12, 12)
    assert {"loss", "psnr"} <= set(ctx.figures)
    for value, kind in ((asset, Asset), (history, Metrics)):
        folder = tmp_path / kind.__name__
        folder.mkdir()
        value.save(folder)
        again = kind.load(folder)
        assert type(again) is kind
    assert (again.values["curves"]["iteration"]) == [0, 10, 11]


@pytest.mark.skipif(torch.cuda.is_available(), reason="a machine without CUDA refuses it")
def test_the_fit_computes_where_its_parameter_says(carrier, train_views):
    p = stage2.FitParams(iterations=1, environment_height=8, corrections=0, device="cuda")
    with pytest.raises(MissingLibraryError, match="no CUDA device"):
        stage2.fit(FakeContext(node="pbr"), carrier, train_views, MonteCarloSettings(), p=p)


def test_the_defaults_are_the_papers_table():
    p = stage2.FitParams()
    assert (p.material_rate, p.environment_rate, p.ssim_weight, p.environment_height) == (2.5e-3, 1.5e-2, 0.2, 256)
    assert p.material_weight == p.environment_weight == p.chroma_weight == 0.1
    assert (p.iterations, p.indirect_weight, p.indirect_ramp) == (10_000, 1.0, 1000)
    light = MonteCarloSettings()
    assert (light.technique, light.samples, light.secondary_rays, light.secondary_samples) == ("environment", 8, 16, 4)


@pytest.mark.parametrize("bad", [{"iterations": 0}, {"min_coverage": 0}, {"corrections": -1}, {"nonsense": 1}])
def test_bad_parameters_are_refused(bad):
    with pytest.raises(ValidationError):
        stage2.FitParams(**bad)
