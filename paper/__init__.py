"""The paper, reproduced: E. Boidot and E. Feron, Planning random path distributions ..."""
