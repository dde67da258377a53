from .channel import (
    ChannelRun as ChannelRun,
    EnergyLedger as EnergyLedger,
    PassivityController as PassivityController,
    channel_run as channel_run,
)
from .delays import (
    Delay as Delay,
    packet_delay as packet_delay,
    random_walk_delay as random_walk_delay,
)
from .filters import (
    FilterRun as FilterRun,
    PassivityMargin as PassivityMargin,
    TwoPortFilter as TwoPortFilter,
    corrected_filter as corrected_filter,
    passivity_margin as passivity_margin,
    printed_filter as printed_filter,
    sinusoid_energy as sinusoid_energy,
)
from .loop.hooks import DivergenceError as DivergenceError, PartError as PartError
from .loop.settings import (
    SCHEMES as SCHEMES,
    STUDIES as STUDIES,
    Guidance as Guidance,
    GuidanceBudget as GuidanceBudget,
    LoopSettings as LoopSettings,
    Scheme as Scheme,
)
from .ports import (
    HapticDevice as HapticDevice,
    PassivityError as PassivityError,
    Scattering as Scattering,
)
from .stability import Passivity as Passivity, passivity as passivity
from .team.decisions import (
    GivenSequence as GivenSequence,
    LeaderPolicy as LeaderPolicy,
    MostTrusted as MostTrusted,
    RandomLeaders as RandomLeaders,
    TeamSituation as TeamSituation,
)
from .team.graphs import (
    GraphError as GraphError,
    team_graph as team_graph,
)
from .team.settings import (
    TeamChannel as TeamChannel,
    TeamOperator as TeamOperator,
    TeamRobot as TeamRobot,
    TeamSettings as TeamSettings,
    TeamTrial as TeamTrial,
)
