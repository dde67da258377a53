"""`tl.LiveTeam`: one person leads a team of robots to goals, in a notebook."""

from pathlib import Path

from trustlab.live.attempt import Attempt
from trustlab.live.ground_robot import LiveWidget
from trustlab.live.tasks.team import TASK, LeadingSettings
from trustlab.models.checks import check_participant, of_class, one_of, whole_number


class LiveTeam(LiveWidget):
    """
    A person leads a team of three to six robots to goals, in a notebook.

    The person pulls the robot that leads; the others follow it by (4.22), and the robots differ in
    speed, lost packets and drift. Trust (4.1) in each robot comes from how it moves. Whoever leads
    does so for τ_min at least. Physics is that of `TeamLoop` and stays in the kernel, so that the
    hand is answered as late as the kernel answers; each row is on the disk before the page forgets
    it. Nothing is felt: the force is an arrow, a visual cue, and the vibration of a gamepad, a
    vibration cue without a direction.

    Parameters
    ----------
    condition : {"by_hand", "most_trusted", "hysteresis", "suggested"}
        Who chooses the leader: the person, with the keys 1 to N; a policy; or the person, to whom
        the policy with hysteresis suggests one that the space bar accepts.
    settings : LeadingSettings, optional
        Robots, goals, length and τ_min.
    participant : str or int
        Who leads.
    seed : int
        Of start, goals, and which robot can do what.
    folder : str or Path
        Where rows are kept.
    language : {"en", "de"}
        Language of what the widget says.

    Attributes
    ----------
    session : Session
        What has been done so far, at 20 Hz: hand, leader, choice and suggestion, whom each policy
        would pick, trust in each robot, distance to the goal, force.
    verified : bool
        Whether all rows so far are, bit for bit, what their commands lead to.

    Raises
    ------
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> live = tl.LiveTeam("by_hand", seed=0, folder="live")
    >>> live.attempt.rows
    []
    """

    session = LiveWidget.session  # a member of its own has a place in the documentation

    def __init__(
        self,
        condition: str = "by_hand",
        settings: LeadingSettings | None = None,
        participant: str | int = "me",
        seed: int = 0,
        folder: str | Path = "live",
        language: str = "en",
    ):
        one_of("condition", condition, TASK.conditions)
        check_participant(participant)
        settings = LeadingSettings() if settings is None else settings
        content = of_class("settings", settings, LeadingSettings).as_json()
        seed = whole_number("seed", seed, least=0, most=2**32 - 1)
        config = TASK.config(content, condition, {}, seed) | {"served": True}
        super().__init__(Attempt.of(folder, str(participant), config), language)
