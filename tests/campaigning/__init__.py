"""Parts of `tests/campaign.py`: what is done to the commands, and how it is judged."""
