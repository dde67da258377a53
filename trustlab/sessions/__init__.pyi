from . import metrics as metrics, recipe as recipe
from .drafting import draft_recipe as draft_recipe
from .errors import RecipeError as RecipeError, SessionError as SessionError
from .folders import external_data as external_data
from .metrics import tracking_error as tracking_error
from .plots import plot_by_participant as plot_by_participant, plot_paths as plot_paths
from .reading import (
    Sessions as Sessions,
    example as example,
    read_frame as read_frame,
    read_session as read_session,
    read_sessions as read_sessions,
)
from .recipe import Recipe as Recipe, load_recipe as load_recipe
from .session import Metadata as Metadata, Session as Session
from .vocabulary import vocabulary as vocabulary
from .writing import write_session as write_session
