"""Panels: functions that draw the session; no GL."""
