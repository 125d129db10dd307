"""What `revisit query` says of a cloud that has no pose."""

from __future__ import annotations

import pytest

from revisit.cli.queries import unplaced


@pytest.mark.parametrize(("reasons", "said"), [
    ([], "not in the map"), (["LOW_SCORE", "LOW_OVERLAP"], "not in the map"),
    (["LOW_SCORE", "AMBIGUOUS"], "Several poses in the map fit"),
])  # fmt: skip
def test_a_cloud_that_fits_several_poses_is_not_told_to_be_elsewhere(reasons, said):
    assert said in unplaced(reasons)
