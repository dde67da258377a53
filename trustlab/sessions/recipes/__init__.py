"""The recipes that come with the package; `trustlab.sessions.recipe` explains their keys."""
