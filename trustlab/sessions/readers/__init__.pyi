from .file import read_frame as read_frame, read_session as read_session
from .folder import Sessions as Sessions, read_sessions as read_sessions
from .joining import join_sessions as join_sessions
