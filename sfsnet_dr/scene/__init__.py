"""Face models, appearance and cameras, and how they become a Mitsuba scene."""
