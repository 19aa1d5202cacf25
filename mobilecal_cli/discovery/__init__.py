"""Discovery of cameras, joints, wheels and head chain by message type and name, where not configured."""

from mobilecal_cli.discovery.chain import nominal_of
from mobilecal_cli.discovery.counters import may_be_a_reading
from mobilecal_cli.discovery.draft import draft_rig
from mobilecal_cli.discovery.joints import outside_chain
from mobilecal_cli.discovery.priors import prior_sigmas, shown_priors
from mobilecal_cli.discovery.resolve import (
    Part,
    ResolvedRig,
    Survey,
    complete_rig,
    resolve_rig,
    stereo_layout,
    survey_rig,
)

__all__ = [
    "Part",
    "ResolvedRig",
    "Survey",
    "complete_rig",
    "draft_rig",
    "may_be_a_reading",
    "nominal_of",
    "outside_chain",
    "prior_sigmas",
    "resolve_rig",
    "shown_priors",
    "stereo_layout",
    "survey_rig",
]
