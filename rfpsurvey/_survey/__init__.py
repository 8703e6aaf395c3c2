"""Surveys of many tiles, from the request to the stored result."""
