static const int appl_planner_version = 1; int appl_planner_abi(void); int appl_planner_abi(void) { return appl_planner_version; }
