"""The history of a survey: recorded events, and the state of targets and tiles that follows from them."""
