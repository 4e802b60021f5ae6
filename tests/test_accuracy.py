"""What the table of accuracy says of the difference between two methods."""

import numpy as np
import pytest

from benchmarks.accuracy import ERRORS, differences


def test_differences_are_paired_by_scene():
    """A difference that is the same in every scene has no error, however the scenes differ."""
    rows = [
        {"scene": scene, "bands": 9, "method": method}
        | dict.fromkeys(ERRORS, 10.0 * scene + 0.5 * (method == "local"))
        for scene in range(4)
        for method in ("net+sgd", "local")
    ]
    rows[0]["texture_correlation"] = np.nan  # a room
    said = {line.split()[1]: line.split() for line in list(differences(rows))[1:]}
    assert said.keys() == set(ERRORS)
    assert [float(n) for n in said["temperature_mae_k"][2:4]] == pytest.approx([-0.5, 0])
    assert said["temperature_mae_k"][4:] == ["4", "of", "4"]
    assert said["material_accuracy"][4:] == ["0", "of", "4"]
    assert said["texture_correlation"][4:] == ["0", "of", "3"]
