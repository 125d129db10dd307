"""The one transaction that merges: copies of sessions, loops, a version of the poses and the end of the job, together.

The sessions of the source are copied, with the names of their blobs, so that the source stays as it is and everything
that a map can do it can do with them. The copies are finished: a robot that drives on goes on in its own map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from revisit.core.geometry.se3 import pose_row
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import validated_id
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapMergeRecord, MapRecord, SessionRecord
from revisit.service.domain.states import AnchorFrame, LoopEventKind, LoopState, MergeVerdict, SessionState
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.graph.anchors import origin_by
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.graph.reading import MapTask, with_evidence
from revisit.service.features.graph.told_changes import find_changes_soon
from revisit.service.features.loops.claims import verdict_evidence
from revisit.service.features.loops.rows import Change, add_loop
from revisit.service.features.merging.rules import MergeProposal
from revisit.service.features.optimisation.rows import add_version, forget_versions, summary_of
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.map_optimiser import OptimisedMap, OptimisedTrack, RefusedJoin
from revisit.service.ports.storage import require_deleted
from revisit.service.ports.transactions import UnitOfWork

_PAGE = 500

NOTHING_TO_MERGE = {"outcome": "one of the maps is gone, or holds no described submap"}
"""The result of a job that had nothing to merge."""


@dataclass(frozen=True)
class _Copies:
    """Numbers of the copies in the map: numbers of sessions, submaps and loops by those of the originals."""

    sessions: dict[int, SessionRecord] = field(default_factory=dict)
    submaps: dict[int, int] = field(default_factory=dict)
    loops: dict[int, LoopRecord] = field(default_factory=dict)


@dataclass(frozen=True)
class MergeCommit:
    """Commits a proposal; the policy says how many versions stay, beside those that merges lead back to."""

    lease: Lease
    proposal: MergeProposal
    policy: Policy
    now_ns: int

    def __call__(self, uow: UnitOfWork) -> bool:
        """Commit, or change nothing and return False where one of the maps has changed since it was read.

        Raises StaleLease where another worker holds the job, AlreadyExists where a session cannot get a name.
        """
        current = self._unchanged(uow)
        uow.queue.require(self.lease)
        if current is None:
            return False
        copies = self._copy(uow, current)
        failpoint("map_merge.after_rows")
        current = uow.maps.get(current.tenant, current.map_id) or current  # anchors of the copies may give it an origin
        report = self._store(uow, current, copies)
        forget_versions(uow, current.tenant, current.map_id, current.map_version + 1 - self.policy.map_versions_kept)
        uow.queue.complete(self.lease, report)
        find_changes_soon(uow, current.tenant, current.map_id, self.policy, self.now_ns)
        if self._copied_anchors(uow, current, copies) or self._asks_surfaces:
            optimise_soon(uow, current.tenant, current.map_id, self.policy, self.now_ns, decided=True)
        return True

    @property
    def _asks_surfaces(self) -> bool:
        """Whether the version of the merge has undecided faults of odometry, on which the next one asks surfaces."""
        return any(one.undecided for one in self.proposal.aligned.optimised.faults)

    def _copied_anchors(self, uow: UnitOfWork, current: MapRecord, copies: _Copies) -> bool:
        """Whether the version of the merge knows nothing yet of anchors that came with the copies."""
        ids = (copy.session_id for copy in copies.sessions.values())
        return any(uow.anchors.find(current.tenant, limit=1, map_id=current.map_id, session_id=one) for one in ids)

    def _unchanged(self, uow: UnitOfWork) -> MapRecord | None:
        """The map that grows, None where one of both has lost a part, got another version, or is gone."""
        records = []
        for side in (self.proposal.task.target, self.proposal.task.source):
            known = side.task.map
            current = uow.maps.get(known.tenant, known.map_id, hold=True)
            if current is None or _grounds(current) != _grounds(known):
                return None
            records.append((current, known))
        (target, as_read), _ = records
        return target if target.map_version == as_read.map_version and self._has_all(uow) else None

    def _has_all(self, uow: UnitOfWork) -> bool:
        """Whether all that the copies will name is there, as it was read: retention may have taken places or scans."""
        source = self.proposal.task.source
        standings = uow.submaps.standings(source.task.map.tenant, source.task.map.map_id)
        now = {one.number: (one.state, one.kept_scans) for one in standings}
        return all(now.get(one.number) == (one.state, one.kept_scans) for one in source.submaps)

    # -- rows

    def _copy(self, uow: UnitOfWork, target: MapRecord) -> _Copies:
        copies = _Copies()
        for number, session in sorted(self.proposal.task.source.sessions.items()):
            copies.sessions[number] = uow.sessions.add(self._session(uow, target, session))
            self._copy_scans(uow, session, copies.sessions[number])
            self._copy_anchors(uow, target, session, copies.sessions[number])
        self._copy_submaps(uow, target, copies)
        for loop in with_evidence(uow, self.proposal.task.source.task.loops):
            copies.loops[loop.number] = self._copy_loop(uow, target, loop, copies)
        for number, record in self._crossing(target, copies):
            change = Change(LoopEventKind.VERIFIED, self.now_ns, details=self._origin())
            copies.loops[number] = add_loop(uow, record, change)
        return copies

    def _session(self, uow: UnitOfWork, target: MapRecord, session: SessionRecord) -> SessionRecord:
        require_deleted(uow, target.tenant, target.map_id, session.session_id)
        taken = uow.sessions.get(target.tenant, target.map_id, session.session_id) is not None
        name = f"{session.map_id}.{session.session_id}" if taken else session.session_id
        require_deleted(uow, target.tenant, target.map_id, name)
        if uow.sessions.get(target.tenant, target.map_id, validated_id(name, "session_id")) is not None:
            raise AlreadyExists(f"map {target.map_id} has a session {name} already")
        finished = self.now_ns if session.finished_at_ns is None else session.finished_at_ns
        return replace(
            session,
            map_id=target.map_id,
            session_id=name,
            state=SessionState.FINISHED.value,
            finished_at_ns=finished,
            changes_told=None,
            number=0,
        )

    def _copy_scans(self, uow: UnitOfWork, session: SessionRecord, copy: SessionRecord) -> None:
        after: int | None = 0
        while after is not None:
            asked = {"map_id": session.map_id, "session_id": session.session_id}
            page = uow.scans.find(session.tenant, after=after, limit=_PAGE, **asked)
            uow.scans.add_all([replace(one, map_id=copy.map_id, session_id=copy.session_id, number=0) for one in page])
            after = page[-1].number if len(page) == _PAGE else None

    def _copy_anchors(self, uow: UnitOfWork, target: MapRecord, session: SessionRecord, copy: SessionRecord) -> None:
        """Those on earth and tags, which hold the next version; metres from another map's origin say nothing here."""
        anchors = uow.anchors.find(session.tenant, map_id=session.map_id, session_id=session.session_id)
        on_earth = [one for one in anchors if one.frame == AnchorFrame.WGS84]
        uow.anchors.add_all(
            [
                replace(one, map_id=copy.map_id, session_id=copy.session_id, number=0)
                for one in anchors
                if one.frame != AnchorFrame.LOCAL
            ]
        )
        current = uow.maps.get(target.tenant, target.map_id)
        if current is not None and current.origin is None and on_earth:
            uow.maps.replace(replace(current, origin=origin_by(current, on_earth)))

    def _copy_submaps(self, uow: UnitOfWork, target: MapRecord, copies: _Copies) -> None:
        for submap in self.proposal.task.source.submaps:
            of = copies.sessions[submap.session_number]
            own = replace(
                submap, map_id=of.map_id, session_id=of.session_id, session_number=of.number, searched=True, number=0
            )
            copies.submaps[submap.number] = uow.submaps.add(own).number
            uow.changes.record_described(target, copies.submaps[submap.number])

    def _copy_loop(self, uow: UnitOfWork, target: MapRecord, loop: LoopRecord, copies: _Copies) -> LoopRecord:
        query, match = copies.submaps[loop.query_number], copies.submaps[loop.match_number]
        ids = {one.number: one.session_number for one in self.proposal.task.source.submaps}
        own = replace(
            loop,
            map_id=target.map_id,
            loop_id=f"loop-{query}-{match}-{loop.number}",
            query_number=query,
            match_number=match,
            query_session_id=copies.sessions[ids[loop.query_number]].session_id,
            match_session_id=copies.sessions[ids[loop.match_number]].session_id,
            graph_state=None,
            manual=False,
            number=0,
        )
        details = {**self._origin(), "copy_of": f"maps/{loop.map_id}/loopClosures/{loop.loop_id}"}
        return add_loop(uow, own, Change(LoopEventKind.VERIFIED, self.now_ns, details=details))

    def _crossing(self, target: MapRecord, copies: _Copies) -> Iterator[tuple[int, LoopRecord]]:
        for number, found in self.proposal.numbers.items():
            of = copies.sessions[found.query.session_number]
            own = replace(
                found.query,
                map_id=of.map_id,
                session_id=of.session_id,
                number=copies.submaps[found.query.number],
            )
            measured, rules = found.verdict.measurement, self.policy.for_map(target).verification
            yield (
                number,
                LoopRecord.between(
                    own,
                    found.match,
                    loop_id=f"loop-{own.number}-{found.match.number}",
                    state=LoopState.ACCEPTED.value,
                    reason=None,
                    similarity=found.similarity,
                    score=0.0 if measured is None else float(measured.score),
                    T_match_query=None if measured is None else pose_row(measured.T_match_query),
                    evidence={**verdict_evidence(found.verdict, rules), "model_version": target.model_version},
                    created_at_ns=self.now_ns,
                ),
            )

    def _origin(self) -> dict[str, Any]:
        return {"merge": f"maps/{self.proposal.order.map_id}/merges/{self.lease.job.operation_id}"}

    # -- the version

    def _store(self, uow: UnitOfWork, current: MapRecord, copies: _Copies) -> dict[str, Any]:
        """Add the version, the merge and the entry of the audit log; the result of the job."""
        task, optimised = self._renumbered(copies)
        job, tenant, map_id = self.lease.job, current.tenant, current.map_id
        summary = summary_of(task, optimised.tracks, optimised)
        version = add_version(uow, current, task, optimised, summary, job.operation_id, self.now_ns)
        sessions = {number: copy.session_id for number, copy in copies.sessions.items()}
        report = {
            **self.proposal.report(),
            "verdict": MergeVerdict.MERGED.value,
            "version": f"maps/{map_id}/versions/{version}",
            "merge": f"maps/{map_id}/merges/{job.operation_id}",
            "sessions": [f"maps/{map_id}/sessions/{name}" for name in sessions.values()],
        }
        uow.map_merges.add(
            MapMergeRecord(
                tenant=tenant,
                map_id=map_id,
                merge_id=job.operation_id,
                source=self.proposal.order.source,
                version_before=current.map_version,
                version=version,
                sessions=tuple(sessions.values()),
                report=report,
                created_at_ns=self.now_ns,
            )
        )
        subject, detail = f"maps/{map_id}", {"source": self.proposal.order.source, "version": version}
        audit.append(uow, self.now_ns, AuditEntry(tenant, self.proposal.order.actor, "map_merged", subject, detail))
        failpoint("map_merge.before_end")
        return report

    def _renumbered(self, copies: _Copies) -> tuple[MapTask, OptimisedMap]:
        """The graph and its solution with the numbers that the copies have."""
        both, optimised = self.proposal.task, self.proposal.aligned.optimised
        target, source = both.target.task, both.source.task
        tracks = [replace(
            track, session_number=copies.sessions[track.session_number].number,
            submaps=tuple(copies.submaps[number] for number in track.submaps),
        ) for track in source.graph.tracks]  # fmt: skip
        ids = [copies.sessions[track.session_number].session_id for track in source.graph.tracks]
        graph = replace(target.graph, tracks=target.graph.tracks + tuple(tracks))
        loops = tuple(replace(one, number=_number(one.number, copies)) for one in optimised.loops)
        solved = tuple(_solved(track, copies) for track in optimised.tracks)
        faults = tuple(replace(one, session=str(_session(int(one.session), copies))) for one in optimised.faults)
        task = replace(
            target, graph=graph, session_ids=target.session_ids + tuple(ids),
            loops=target.loops + tuple(copies.loops.values()),
        )  # fmt: skip
        on_earth = tuple(one.renumbered(partial(_session, copies=copies)) for one in optimised.on_earth)
        refused = both.target.refused + tuple(_kept_apart(one, copies) for one in both.source.refused)
        return task, replace(
            optimised, tracks=solved, loops=loops, faults=faults, refused_joins=refused, on_earth=on_earth
        )


def _grounds(record: MapRecord) -> tuple[int, int, str | None]:
    """What a proposal rests on in the row of a map: that it is this map, of these parts, described by this model."""
    return record.number, record.graph_edits, record.model_version


def _number(loop: int, copies: _Copies) -> int:
    return copies.loops[loop].number if loop in copies.loops else loop


def _kept_apart(join: RefusedJoin, copies: _Copies) -> RefusedJoin:
    sides = [tuple(copies.sessions[number].number for number in side) for side in (join.sessions, join.others)]
    return replace(join, sessions=sides[0], others=sides[1])


def _session(number: int, copies: _Copies) -> int:
    return copies.sessions[number].number if number in copies.sessions else number


def _solved(track: OptimisedTrack, copies: _Copies) -> OptimisedTrack:
    return replace(track, session_number=_session(track.session_number, copies), anchor=_session(track.anchor, copies))
