"""Discovery of cameras, joints, wheels and head chain by message type and name, where not configured."""

from mobilecal_cli.discovery.draft import draft_rig
from mobilecal_cli.discovery.priors import prior_sigmas, shown_priors
from mobilecal_cli.discovery.resolve import ResolvedRig, lacking, resolve_rig

__all__ = ["ResolvedRig", "draft_rig", "lacking", "prior_sigmas", "resolve_rig", "shown_priors"]
