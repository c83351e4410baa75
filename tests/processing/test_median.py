"""The median of a map whose rows are read band by band."""

import numpy as np

from processing.superres import higher_resolution as median


def test_the_median_is_that_of_all_values(monkeypatch) -> None:
    monkeypatch.setattr(median, "_READ", 40)
    random = np.random.default_rng(906)
    for shape in ((1, 1), (1, 2), (9, 21), (30, 10)):
        for values in (random.lognormal(0, 3, shape), random.integers(0, 4, shape)):
            found, mask = values.astype(np.float32), random.random(shape) < 0.7
            mask[0, 0] = True
            found[~mask] = np.nan
            assert median._median_of_rows(found, mask) == float(np.median(found[mask]))
