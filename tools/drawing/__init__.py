"""Pictures: graphs, plots, schedules, pages."""
