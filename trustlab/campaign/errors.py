"""What can go wrong with a campaign as a whole."""

from __future__ import annotations

__all__ = ["CampaignError", "CampaignWarning", "WorkerDiedError"]


class CampaignError(ValueError):
    """A campaign that cannot run or go on; the message says what was found and what to do."""


class CampaignWarning(UserWarning):
    """Some runs of a campaign failed."""


class WorkerDiedError(Exception):
    """The process that ran a chunk ended without an answer."""
