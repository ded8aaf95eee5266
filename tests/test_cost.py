"""What networks cost, against counts made by hand and published numbers."""

import pytest

from framecast.cost import cost
from framecast.methods import METHODS


def test_the_published_network() -> None:
    """262,141 parameters and 50.1 billion multiply-accumulates for a generated 1280 x 720 frame."""
    found = cost("extranet-published")
    assert found.parameters == 262_141
    assert found.generated is not None
    assert found.generated * 1280 * 720 == pytest.approx(50.1e9, rel=1e-3)
    assert found.shaded == 0  # its shaded frames pass through


def test_methods_without_networks_cost_nothing() -> None:
    found = cost("mobfgsr")
    assert (found.parameters, found.shaded, found.generated) == (0, 0, 0)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="there is no method 'nothing'"):
        cost("nothing")
    assert "nothing" not in METHODS
