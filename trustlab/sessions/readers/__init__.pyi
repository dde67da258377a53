from .file import (
    Sessions as Sessions,
    join_sessions as join_sessions,
    read_frame as read_frame,
    read_session as read_session,
    read_sessions as read_sessions,
)
