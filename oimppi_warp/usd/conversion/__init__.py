"""What a stage goes through as it is opened: property types, units, the axis that points up."""
