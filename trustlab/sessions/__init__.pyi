from . import metrics as metrics, recipe as recipe, recipes as recipes
from .drafting import draft_recipe as draft_recipe
from .errors import RecipeError as RecipeError, SessionError as SessionError
from .example import example as example
from .external import external_data as external_data
from .metadata import Metadata as Metadata
from .metrics import tracking_error as tracking_error
from .plots import plot_by_participant as plot_by_participant, plot_paths as plot_paths
from .readers import (
    Sessions as Sessions,
    join_sessions as join_sessions,
    read_frame as read_frame,
    read_session as read_session,
    read_sessions as read_sessions,
)
from .recipe import Recipe as Recipe, list_recipes as list_recipes, load_recipe as load_recipe
from .session import Session as Session
from .vocabulary import vocabulary as vocabulary
from .writers import write_session as write_session
