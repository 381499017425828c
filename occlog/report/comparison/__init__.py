"""Two runs side by side: whether they differ, where they first part, and who became another one."""
