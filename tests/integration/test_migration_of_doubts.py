"""The doubts of a stored loop get the field's terms, and go back, on a database that is in use."""

from __future__ import annotations

import asyncio
import json

from revisit.service.adapters.sqlite.migration import migrate
from tests.support.service_world import described, sqlite_world
from tests.support.stored_rows import run

OLD = {
    "measurement": {"overlap": 0.5},
    "outdone": {"overlap": 0.3, "elsewhere": 0.4, "words": "more"},
    "contradicted": {},
}


def test_doubts_of_before_are_gathered_and_spread_again(tmp_path):
    world = sqlite_world(tmp_path)
    asyncio.run(described(world, first=1, away=30, second=1))
    world.context.transactions.close()
    database = tmp_path / "revisit.db"
    migrate(database, "0020")
    run(database, f"UPDATE loop_closures SET evidence = '{json.dumps(OLD)}'")
    migrate(database)
    ((text,), *_) = run(database, "SELECT evidence FROM loop_closures")
    told = json.loads(text)
    assert told["measurement"] == OLD["measurement"] and told["doubts"]["BETTER_ALTERNATIVE"] == OLD["outdone"]
    assert told["doubts"].keys() == {"BETTER_ALTERNATIVE", "PAIRWISE_INCONSISTENT"} and "outdone" not in told
    migrate(database, "0020")
    ((text,), *_) = run(database, "SELECT evidence FROM loop_closures")
    assert json.loads(text) == {**OLD, "contradicted": {"words": ""}}
