"""The attack on the readers: seeded damage to every kind of file, in processes of its own."""
