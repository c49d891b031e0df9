from __future__ import annotations

import pytest

from nw_gate.stats.interval import t_quantile

# scipy 1.17.1, stats.t.ppf of .5 + confidence / 2.
QUANTILES = {
    (0.95, 1): 12.706204736174694,
    (0.8, 2): 1.8856180831641272,
    (0.95, 3): 3.1824463052837078,
    (0.99, 4): 4.604094871349992,
    (0.95, 9): 2.262157162798205,
    (0.8, 19): 1.3277282090267986,
    (0.99, 30): 2.7499956535672254,
    (0.95, 99): 1.9842169515864174,
}


@pytest.mark.parametrize(("arguments", "expected"), QUANTILES.items())
def test_quantiles_are_scipys(arguments, expected):
    assert t_quantile(*arguments) == pytest.approx(expected, rel=1e-12)
