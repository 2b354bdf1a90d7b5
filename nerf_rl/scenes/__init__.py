"""What is simulated: environments on MuJoCo by name, with their named columns; nothing is drawn here."""
