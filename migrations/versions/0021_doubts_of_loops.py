"""The evidence of a loop names its doubts in one member, by the field's terms."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None

DOUBTS = {
    "contradicted": "PAIRWISE_INCONSISTENT",
    "refuted": "ODOMETRY_INCONSISTENT",
    "look_alikes": "PERCEPTUAL_ALIAS",
    "outdone": "BETTER_ALTERNATIVE",
    "outnumbered": "LOW_CONSISTENT_SHARE",
    "support_lost": "SUPPORT_LOST",
}
PAGE = 1000


def upgrade() -> None:
    """Gather what was a member of its own each."""
    _rewrite(_gathered)


def downgrade() -> None:
    """Spread them again."""
    _rewrite(_spread)


def _rewrite(change) -> None:
    connection, after = op.get_bind(), 0
    read = sa.text("SELECT number, evidence FROM loop_closures WHERE number > :after ORDER BY number LIMIT :page")
    write = sa.text("UPDATE loop_closures SET evidence = :evidence WHERE number = :number")
    while rows := connection.execute(read, {"after": after, "page": PAGE}).all():
        for number, text in rows:
            evidence = json.loads(text)
            changed = change(evidence)
            if changed != evidence:
                connection.execute(write, {"number": number, "evidence": json.dumps(changed)})
        after = rows[-1].number


def _gathered(evidence: dict) -> dict:
    doubts = {DOUBTS[name]: {"words": "", **told} for name, told in evidence.items() if name in DOUBTS}
    kept = {name: value for name, value in evidence.items() if name not in DOUBTS}
    return {**kept, "doubts": {**kept.get("doubts", {}), **doubts}} if doubts else kept


def _spread(evidence: dict) -> dict:
    names = {doubt: name for name, doubt in DOUBTS.items()}
    spread = {names[doubt]: told for doubt, told in evidence.get("doubts", {}).items()}
    return {**{name: value for name, value in evidence.items() if name != "doubts"}, **spread}
