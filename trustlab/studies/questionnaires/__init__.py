"""Questionnaires: answers read and checked, scales scored, reliability."""
