"""What is left when programs are killed, disks are full and places are read-only."""
