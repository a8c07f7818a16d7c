import numpy as np
import pytest

from dds_trace.extensions.bags.quantiles import median, quantile, row_medians


@pytest.mark.parametrize("seed", range(4))
def test_medians_and_quantiles_are_numpys_to_the_last_bit(seed):
    random = np.random.default_rng(seed)
    for count in range(1, 70):
        for values in (
            random.integers(-9, 9, count),
            random.integers(0, 2**62, count),
            random.normal(0, 1, count),
            random.normal(0, 1, count).round(1) * 1e17,
        ):
            assert median(values) == np.median(values)
            rows = np.stack([values, values + 1])
            assert row_medians(rows).tolist() == np.median(rows, axis=1).tolist()
            for share in (0.0, 0.05, 1 - 0.95, 0.5, 0.95, 0.99, 1.0):
                assert quantile(values, share) == np.quantile(values, share)
