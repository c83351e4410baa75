"""Heights of surfaces under near lights."""
