"""Code that all packages use: descriptions, units, readers and writers of files, folders, executors."""
