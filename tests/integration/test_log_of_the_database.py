"""A write-ahead log that is not folded back any more is told of before it becomes a problem."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest

from revisit.service.engines.local.files.disk import Disk
from revisit.service.features.upkeep.calls import LOG_ALARM_BYTES
from revisit.service.use_cases import UseCases
from tests.support.service_world import memory_world


@pytest.mark.parametrize(("size_bytes", "warnings"), [(None, 0), (LOG_ALARM_BYTES, 0), (LOG_ALARM_BYTES + 1, 1)])
async def test_a_log_beyond_its_bound_is_named_while_the_service_stays_ready(tmp_path, size_bytes, warnings):
    if size_bytes is not None:
        (tmp_path / "revisit.db-wal").touch()
        os.truncate(tmp_path / "revisit.db-wal", size_bytes)
    context = replace(memory_world().context, disk=Disk(tmp_path, 0, tmp_path / "revisit.db-wal"))
    assert context.disk.log_bytes() == (size_bytes or 0)
    readiness = await UseCases.over(context, "test").system.readiness()
    assert readiness.ready
    assert len([text for text in readiness.degraded if "log of the database" in text]) == warnings
