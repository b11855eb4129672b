"""The planner's computing environment: devices, prepared launches, and results cached on disk."""
