from .file import (
    Sessions as Sessions,
    read_frame as read_frame,
    read_session as read_session,
    read_sessions as read_sessions,
)
from .joining import join_sessions as join_sessions
