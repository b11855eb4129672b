"""Where a planner computes: devices, prepared launches, and results kept on disk."""
