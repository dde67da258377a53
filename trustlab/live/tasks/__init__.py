"""The tasks that people do live, each behind one protocol."""
