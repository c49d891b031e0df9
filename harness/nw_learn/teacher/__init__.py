"""The teacher: a policy that is told the heights around it, learnt by PPO in plain MuJoCo."""
