"""What can go wrong with a campaign as a whole."""


class CampaignError(ValueError):
    """A campaign that cannot run or go on; the message says what was found and what to do."""


class CampaignWarning(UserWarning):
    """Some runs of a campaign failed."""
