import os

# Tests compare with the CPU backend bit for bit; those of CUDA ask for it by name.
os.environ["GAGA_BACKEND"] = "cpu"
