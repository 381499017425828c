"""`occlog fuse` on tracks: read those of all groups of cameras, fuse, and write."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from occlog.errors import InputError
from occlog.io.open import check_unit, common_unit, input_losses, open_input
from occlog.measure.fuse.request import TrackFusionRequest
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks
from occlog.records.verdicts import Check, finding, outcome
from occlog.runner import Job
from occlog.settings import configure

from .config import TrackFusionConfig
from .stage import FusedGroupTracks, GroupConsistency, fuse_tracks

FOUND, AGREE = "number of people", "camera group agreement"
"""Names of checks."""
MAX_SEPARATION_RATIO = 2.0
"""Ratio of mean difference to expected error from which the positions of a group are reported to differ."""


def run_fuse_tracks(request: TrackFusionRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fuse tracks of several groups of cameras and write tracks and events; return the summary and input losses."""
    paths = (request.bearings, *request.others)
    opened = [open_input(path, PeopleTracks) for path in paths]
    unit, source = common_unit(opened)
    for each in opened:
        check_unit(each, unit, source, InputError)
    config = configure(TrackFusionConfig.in_unit(unit), request.settings)
    groups = [each.read(PeopleTracks) for each in opened]
    fused = fuse_tracks(groups, config)
    losses = input_losses(opened)
    made = job.judged(job.provenance(asdict(config), losses), _checks(paths, groups, fused, config, unit))
    with job.tables(made, unit, {"output": type(fused.tracks)}) as tables:
        tables.write(output=fused.tracks, events=fused.events)
    written = {"tracks": str(request.output)} | ({} if request.events is None else {"events": str(request.events)})
    return {**written, **figures(paths, groups, fused)}, losses


def figures(paths: tuple[Path, ...], groups: list[PeopleTracks], fused: FusedGroupTracks) -> dict[str, object]:
    """Return the figures of the summary by name.

    people, rows: of the output. multi_group_share: share of rows of people that several groups track at that time,
    missing without rows. possible_switches: number of times when two identities may have been exchanged (events of the
    kind `possible_switch`, of which each of the two has a row). groups: for each input file its number of people, and
    for each but the first the rows matched with groups before (matched_pairs) and the median distance of the matched
    positions (median_separation [length]).

    Args:
        paths: file of each group.
        groups: tracks of each group.
        fused: result of the fusion.
    """
    several = np.char.count(fused.tracks.source_ids, "-") < len(groups) - 1 if len(fused.tracks) else np.zeros(0)
    by_group: dict[str, object] = {}
    for index, (path, group) in enumerate(zip(paths, groups, strict=True)):
        reported: dict[str, object] = {"people": len(np.unique(group.target_id))}
        if index:
            agreement = fused.agreements[index - 1]
            reported |= {"matched_pairs": agreement.pairs}
            reported |= {"median_separation": agreement.distance} if agreement.pairs else {}
        by_group[path.name if path.name not in by_group else str(path)] = reported
    return {
        "people": len(np.unique(fused.tracks.target_id)),
        "rows": len(fused.tracks),
        **({"multi_group_share": float(several.mean())} if len(several) else {}),
        "possible_switches": round(fused.events.counts().get("possible_switch", 0)),
        "groups": by_group,
    }


def _checks(
    paths: tuple[Path, ...], groups: list[PeopleTracks], fused: FusedGroupTracks, config: TrackFusionConfig, unit: str
) -> tuple[Check, ...]:
    """Check that every group has tracks, and that each group agrees with those before it.

    A group without common times or matched people does not agree. The second check has no findings if all groups are
    empty.

    Args:
        paths: file of each group.
        groups: tracks of each group.
        fused: has the agreement of each group but the first with those before.
        config: gives the standard deviation of the registration of groups.
        unit: name of the length unit, for messages.
    """
    anybody = any(len(group) for group in groups)
    empty = (
        finding(FOUND, "group-without-tracks", file=str(path))
        for path, group in zip(paths, groups, strict=True)
        if not len(group)
    )
    return (*outcome(FOUND, empty), *outcome(AGREE, _apart(paths, groups, fused, config, unit) if anybody else ()))


def _apart(
    paths: tuple[Path, ...], groups: list[PeopleTracks], fused: FusedGroupTracks, config: TrackFusionConfig, unit: str
) -> Iterator[Check]:
    """Findings about each group of cameras that disagrees with the groups before it.

    It has no time step in common, no matched people, or a mean offset above `MAX_SEPARATION_RATIO` times the standard
    deviation of the groups' registration in `config`. Groups without tracks are skipped. `paths` are the files of the
    groups, `unit` names the length unit.
    """
    for path, group, agreement in zip(paths[1:], groups[1:], fused.agreements, strict=True):
        if not len(group):
            continue
        if not agreement.n_common:
            yield finding(AGREE, "group-times-disjoint", file=str(path))
        elif not agreement.pairs:
            yield finding(AGREE, "group-without-common-targets", file=str(path), steps=agreement.n_common)
        elif _beside(agreement, config):
            x, y = agreement.offset
            yield finding(
                AGREE,
                "group-misaligned",
                file=str(path),
                offset=math.hypot(x, y),
                x=x,
                y=y,
                unit=unit,
                allowed=MAX_SEPARATION_RATIO * config.sigma_registration,
            )


def _beside(agreement: GroupConsistency, config: TrackFusionConfig) -> bool:
    return math.hypot(*agreement.offset) > MAX_SEPARATION_RATIO * config.sigma_registration > 0.0
