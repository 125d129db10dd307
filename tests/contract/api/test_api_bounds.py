"""Each bound is stated once, in `contract.limits`: OpenAPI and the comments of the proto files say the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from revisit.service.domain import limits
from revisit.v1.comments import COMMENTS

DOCUMENT = json.loads((Path(__file__).resolve().parents[3] / "docs/reference/openapi.json").read_text())
BOUNDS = {
    "tau_m": limits.TAU_M, "stride_m": limits.STRIDE_M, "leave_distance_m": limits.LEAVE_DISTANCE_M,
    "scene_scale": limits.SCENE_SCALE, "min_score": limits.MIN_SCORE, "min_overlap": limits.MIN_OVERLAP,
    "max_seen_through": limits.MAX_SEEN_THROUGH, "candidates": limits.LOOP_CANDIDATES, "k": limits.K,
    "min_similarity": limits.MIN_SIMILARITY, "radius_m": limits.RADIUS_M, "page_size": limits.PAGE_SIZE,
    "min_seq_timeout_s": limits.WAIT_S, "timeout_s": limits.WAIT_S, "prior_position_m": limits.PRIOR_COORDINATE_M,
    "vector": limits.DESCRIPTOR_LENGTH,
}  # fmt: skip
ONLY_IN_REST = {"seq": limits.SCAN_SEQ, "stamp_ns": limits.STAMP_NS, "min_seq": limits.MIN_SEQ}
CHARACTERS = {
    "display_name": limits.DISPLAY_NAME_CHARACTERS,
    "page_token": limits.PAGE_TOKEN_CHARACTERS,
    "model_version": limits.MODEL_VERSION_CHARACTERS,
    "storey": limits.STOREY_CHARACTERS,
}
IDS = ["map_id", "robot_id", "session_id", "submap_id"]


def comments_of(name: str) -> dict[str, str]:
    """The comments of the fields of requests that are called `name`."""
    return {
        full_name: text
        for full_name, text in COMMENTS.items()
        if full_name.endswith(f".{name}") and re.search(r"Request\.|LoopPolicy\.|Descriptor\.", full_name)
    }


def schemas_of(name: str, part: object = DOCUMENT["paths"]) -> list[dict]:
    """The schemas of every parameter and member of a request that is called `name`."""
    if isinstance(part, list):
        return [schema for item in part for schema in schemas_of(name, item)]
    if not isinstance(part, dict):
        return []
    found = [part["schema"]] if part.get("name") == name and "schema" in part else []
    found += [part["properties"][name]] if name in part.get("properties", ()) else []
    return found + [schema for key, item in part.items() if key != "responses" for schema in schemas_of(name, item)]


def alternatives(schema: dict) -> list[dict]:
    """What a value may be, but for null."""
    return [one for one in schema.get("anyOf", [schema]) if one.get("type") != "null"]


@pytest.mark.parametrize("name", BOUNDS)
def test_the_comments_of_the_proto_files_state_the_bounds(name):
    found = comments_of(name)
    assert found
    for full_name, text in found.items():
        stated = re.search(r"(Above )?(-?[0-9](?:[0-9.e]*[0-9])?) to (-?[0-9](?:[0-9.e]*[0-9])?)", text)
        assert stated, full_name
        above, least, most = stated.groups()
        bound = BOUNDS[name]
        assert (float(least), float(most), bool(above)) == (bound.least, bound.most, bound.above), full_name


@pytest.mark.parametrize("name", sorted({**BOUNDS, **ONLY_IN_REST}.keys() - {"vector", "prior_position_m"}))
def test_openapi_states_the_bounds(name):
    bound = {**BOUNDS, **ONLY_IN_REST}[name]
    found = [one for schema in schemas_of(name) for one in alternatives(schema)]
    assert found
    for schema in found:
        assert schema["exclusiveMinimum" if bound.above else "minimum"] == bound.least, schema
        assert schema["maximum"] == bound.most, schema


def test_openapi_states_the_bounds_of_what_is_in_lists():
    (prior,), (descriptor,) = (
        [one for schema in schemas_of(name) for one in alternatives(schema) if one["type"] == "array"]
        for name in ("prior_position_m", "descriptor")
    )
    assert (prior["items"]["minimum"], prior["items"]["maximum"]) == (-1e9, 1e9)
    assert (descriptor["minItems"], descriptor["maxItems"]) == (1, 10_000)


@pytest.mark.parametrize("name", CHARACTERS)
def test_both_state_how_long_a_text_may_be(name):
    texts, schemas = comments_of(name), schemas_of(name)
    assert texts and schemas
    for text in texts.values():
        assert f"t most {CHARACTERS[name]} " in text
    for schema in schemas:
        assert alternatives(schema)[0]["maxLength"] == CHARACTERS[name]


@pytest.mark.parametrize("name", IDS)
def test_both_state_the_pattern_of_ids(name):
    assert set(comments_of(name).values()) == {limits.ID_PATTERN}
