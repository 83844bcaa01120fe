"""The explorer: a scene in the browser with a slider for each number."""
