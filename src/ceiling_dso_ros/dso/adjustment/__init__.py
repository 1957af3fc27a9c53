"""The bundle adjustment over the window, and what marginalised parts leave behind."""
