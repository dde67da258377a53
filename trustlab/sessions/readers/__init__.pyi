from .file import read_session as read_session
from .folder import read_sessions as read_sessions
