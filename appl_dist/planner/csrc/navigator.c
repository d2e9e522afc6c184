#include <string.h>

#include "memory_layout.h"
#include "wide.h"

#define PI 3.14159265358979323846

navigator *navigator_init(void *memory, const planner_settings *set, const planner_parameters *par, bool fast) {
    arena a = {memory, 0};
    navigator *n = arena_alloc(&a, sizeof *n);
    memset(n, 0, sizeof *n);
    memory_layout_navigator(n, set, &a);
    n->set = *set;
    n->shape = footprint_make(set->half_length_m, set->half_width_m, set->footprint_padding);
    rollout_planner *r = &n->local_plan.rollouts;
    r->set = &n->set;
    r->shape = n->shape;
    footprint_lines_make(&r->lines, footprint_line_reach(&n->shape, set->resolution_m), n->local.frame.w);
    for (int i = 0; i < (int)set->beams; ++i) {
        const double angle = -set->angle_max_rad + i * (2 * set->angle_max_rad / ((int)set->beams - 1));
        n->beam_cos[i] = cos(angle);
        n->beam_sin[i] = sin(angle);
    }
    n->plan.single = fast;
    n->plan.margin = fast ? NAVFN_MARGIN_FAST : NAVFN_MARGIN_EXACT;
    n->local.inflate.stamps = n->global.inflate.stamps = fast;
    navfn_init(&n->plan);
    navigator_set_parameters(n, par);
    costmap_clear(&n->local, 0, 0);
    costmap_clear(&n->global, set->global_origin_m, set->global_origin_m);
    local_planner_reset(&n->local_plan);
    n->state = NAVIGATOR_IDLE;
    n->now = n->last_valid_plan = n->last_valid_control = NAN;
    return n;
}

void navigator_reset(navigator *n, const double goal[3]) {
    costmap_clear(&n->local, 0, 0);
    costmap_clear(&n->global, n->set.global_origin_m, n->set.global_origin_m);
    navfn_sync(&n->plan, n->global.master, n->global.touched);
    navfn_restart(&n->plan);
    n->latest_count = 0;
    local_planner_reset(&n->local_plan);
    memcpy(n->goal, goal, sizeof n->goal);
    n->seen.count = 0;
    n->state = NAVIGATOR_PLANNING;
    n->reason = RECOVERY_FOR_PLANNING;
    n->turn.active = false;
    n->run_planner = true;
    n->new_plan = n->have_plan = false;
    n->recovery_index = n->recoveries = 0;
    n->now = n->last_valid_plan = n->last_valid_control = NAN;
    n->valid = false;
    n->cycles = 0;
}

void navigator_set_parameters(navigator *n, const planner_parameters *par) {
    planner_parameters p = *par;
    p.vx_samples = floor(p.vx_samples);  // dynamic_reconfigure hands out whole numbers
    p.vtheta_samples = floor(p.vtheta_samples);
    n->par = p;
    rollout_set_parameters(&n->local_plan.rollouts, &p);
    n->local_plan.reached_goal = false;
    const double inscribed = fmin(n->shape.x[2], n->shape.y[1]);
    costmap *maps[2] = {&n->local, &n->global};
    for (int i = 0; i < 2; ++i)
        inflation_set(&maps[i]->inflate, p.inflation_radius, n->set.cost_scaling_factor, inscribed,
                      n->set.resolution_m);
}

WIDE static void project(const float *ranges, const double *beam_cos, const double *beam_sin, int count, double c,
                         double s, const observation *o) {
    float *to_x = o->x;
    float *to_y = o->y;
    for (int i = 0; i < count; ++i) {
        const double r = ranges[i];
        const float x = (float)(r * beam_cos[i]);
        const float y = (float)(r * beam_sin[i]);
        to_x[i] = (float)(o->ox + (x * c - y * s));
        to_y[i] = (float)(o->oy + (x * s + y * c));
    }
}

// As the scan reaches the maps in ROS: points in the laser's frame as float32 (LaserProjection), then moved to odom
// and rounded to float32 again.
void navigator_add_scan(navigator *n, const float *ranges, const double pose[3]) {
    observation *o = &n->seen;
    o->count = 0;
    if (!isfinite(pose[0]) || !isfinite(pose[1]) || !isfinite(pose[2])) return;
    const double c = cos(pose[2]);
    const double s = sin(pose[2]);
    o->ox = pose[0] + n->set.laser_x_m * c;
    o->oy = pose[1] + n->set.laser_x_m * s;
    const int beams = (int)n->set.beams;
    project(ranges, n->beam_cos, n->beam_sin, beams, c, s, o);
    for (int i = 0; i < beams; ++i) {
        if (!(ranges[i] > 0 && ranges[i] < 1e6f)) continue;
        o->x[o->count] = o->x[i];
        o->y[o->count] = o->y[i];
        o->count += 1;
    }
}

static void robot_pose(const double pose[3], double out[3]) {
    out[0] = pose[0];
    out[1] = pose[1];
    out[2] = yaw_through_quaternion(pose[2]);
}

void navigator_update_local(navigator *n, const double pose[3]) {
    double p[3];
    robot_pose(pose, p);
    costmap_update(&n->local, &n->scratch, &n->set, &n->shape, &n->seen, p);
}

void navigator_update_global(navigator *n, const double pose[3]) {
    double p[3];
    robot_pose(pose, p);
    costmap_update(&n->global, &n->scratch, &n->set, &n->shape, &n->seen, p);
    navfn_sync(&n->plan, n->global.master, n->global.touched);
}

static void start_clock(navigator *n, double now) {
    n->now = now;
    if (isnan(n->last_valid_plan)) n->last_valid_plan = now;
    if (isnan(n->last_valid_control)) n->last_valid_control = now;
}

// One turn of MoveBase::planThread.
bool navigator_plan(navigator *n, const double pose[3], double now) {
    if (!n->run_planner || n->state == NAVIGATOR_IDLE) return false;
    if (!isnan(now)) start_clock(n, now);
    costmap_mark_cleared(&n->global, pose[0], pose[1]);
    if (navfn_plan(&n->plan, &n->global.frame, n->global.master, pose[0], pose[1], n->goal[0], n->goal[1])) {
        n->latest_count = n->plan.plan_count;
        memcpy(n->latest, n->plan.plan, sizeof(double) * 2 * (size_t)n->latest_count);
        n->new_plan = n->have_plan = true;
        n->last_valid_plan = n->now;
        n->state = NAVIGATOR_CONTROLLING;
        return true;
    }
    if (n->state == NAVIGATOR_PLANNING && n->now > n->last_valid_plan + n->set.planner_patience) {
        n->state = NAVIGATOR_CLEARING;
        n->run_planner = false;
        n->reason = RECOVERY_FOR_PLANNING;
    }
    return false;
}

// One step of rotate_recovery: a full turn to the left, given up where the outline would touch something.
// False when it is over.
static bool keep_turning(navigator *n, const double pose[3], double out[2]) {
    const planner_settings *s = &n->set;
    rotation *t = &n->turn;
    if (t->half && fabs(shortest_angle(pose[2], t->start_yaw)) <= s->yaw_goal_tolerance) return false;
    double left;
    if (!t->half) {
        const double to_half = fabs(shortest_angle(pose[2], t->start_yaw + PI));
        left = PI + to_half;
        if (to_half < s->yaw_goal_tolerance) t->half = true;
    } else {
        left = fabs(shortest_angle(pose[2], t->start_yaw));
    }
    for (double ahead = 0; ahead < left; ahead += s->rotate_granularity_rad) {
        const double th = pose[2] + ahead;
        int cx, cy;
        if (!world_to_map(&n->local.frame, pose[0], pose[1], &cx, &cy)) return false;
        if (footprint_outline_cost(&n->shape, &n->local_plan.rollouts.lines, &n->local.frame, n->local.master, pose[0],
                                   pose[1], cos(th), sin(th)) < 0)
            return false;
    }
    out[1] = fmin(fmax(sqrt(2 * s->acc_lim_theta * left), s->min_in_place_vel_theta), s->rotate_max_vel_theta);
    return true;
}

static void finish_recovery(navigator *n) {
    n->turn.active = false;
    n->last_valid_plan = n->now;
    n->state = NAVIGATOR_PLANNING;
    n->recovery_index += 1;
}

static void abort_goal(navigator *n) {
    n->run_planner = false;
    n->state = NAVIGATOR_ABORTED;
}

static void start_recovery(navigator *n, const double pose[3], double out[2]) {
    if (n->recovery_index >= RECOVERY_BEHAVIOURS) {
        abort_goal(n);
        return;
    }
    n->recoveries += 1;
    if (n->recovery_index % 2 == 0) {  // clear_costmap_recovery of a layer that is not there
        finish_recovery(n);
        return;
    }
    n->turn = (rotation){.active = true, .start_yaw = pose[2]};
    if (!keep_turning(n, pose, out)) finish_recovery(n);
}

static void follow_plan(navigator *n, const double pose[3], const double twist[2], double out[2]) {
    if (n->local_plan.reached_goal) {
        n->run_planner = false;
        n->state = NAVIGATOR_SUCCEEDED;
        return;
    }
    n->valid = local_planner_command(&n->local_plan, &n->local.frame, n->local.master, pose, twist, out);
    if (n->valid) {
        n->last_valid_control = n->now;
        if (n->reason == RECOVERY_FOR_CONTROLLING) n->recovery_index = 0;
        return;
    }
    out[0] = out[1] = 0;
    if (n->now > n->last_valid_control + n->set.controller_patience) {
        n->state = NAVIGATOR_CLEARING;
        n->reason = RECOVERY_FOR_CONTROLLING;
    } else {
        n->last_valid_plan = n->now;
        n->state = NAVIGATOR_PLANNING;
        n->run_planner = true;
    }
}

// MoveBase::executeCycle. A rotation blocks it there; here it takes one step a call until done.
void navigator_control(navigator *n, const double pose_in[3], const double twist[2], double now, double out[2]) {
    double pose[3];
    out[0] = out[1] = 0;
    n->valid = false;
    n->local_plan.rollouts.rollouts = n->local_plan.rollouts.rollout_steps = 0;  // of this cycle, if it comes to any
    if (n->state == NAVIGATOR_IDLE || n->state == NAVIGATOR_SUCCEEDED || n->state == NAVIGATOR_ABORTED) return;
    start_clock(n, now);
    robot_pose(pose_in, pose);
    if (n->turn.active) {
        if (!keep_turning(n, pose, out)) finish_recovery(n);
        return;
    }
    if (n->new_plan) {
        n->new_plan = false;
        local_planner_set_plan(&n->local_plan, n->latest, n->latest_count, n->goal[2]);
        if (n->reason == RECOVERY_FOR_PLANNING) n->recovery_index = 0;
    }
    switch (n->state) {
        case NAVIGATOR_PLANNING:
            n->run_planner = true;
            break;
        case NAVIGATOR_CONTROLLING:
            follow_plan(n, pose_in, twist, out);
            break;
        case NAVIGATOR_CLEARING:
            start_recovery(n, pose, out);
            break;
        default:
            break;
    }
}

void navigator_cycle(navigator *n, const float *ranges, const double pose[3], const double twist[2], double now,
                     double out[2]) {
    navigator_add_scan(n, ranges, pose);
    navigator_update_local(n, pose);
    if (n->cycles % 2 == 0) navigator_update_global(n, pose);
    n->cycles += 1;
    navigator_plan(n, pose, now);
    navigator_control(n, pose, twist, now, out);
}

double navigator_bearing(const navigator *n, const double pose[3], double lookahead) {
    if (!n->have_plan || n->latest_count == 0) return 0;
    const double *p = n->latest;
    int nearest = 0;
    double best = INFINITY;
    for (int i = 0; i < n->latest_count; ++i) {
        const double dx = p[2 * i] - pose[0];
        const double dy = p[2 * i + 1] - pose[1];
        const double d = dx * dx + dy * dy;
        if (d < best) {
            best = d;
            nearest = i;
        }
    }
    double arc = 0;
    int i = nearest;
    while (i < n->latest_count - 1 && arc < lookahead) {
        arc += hypot(p[2 * i + 2] - p[2 * i], p[2 * i + 3] - p[2 * i + 1]);
        ++i;
    }
    const double dx = p[2 * i] - pose[0];
    const double dy = p[2 * i + 1] - pose[1];
    return dx == 0 && dy == 0 ? 0 : shortest_angle(pose[2], atan2(dy, dx));
}

static void add_scan(void *self, const float *ranges, const double pose[3]) { navigator_add_scan(self, ranges, pose); }

static void update_local(void *self, const double pose[3]) { navigator_update_local(self, pose); }

static void update_global(void *self, const double pose[3]) { navigator_update_global(self, pose); }

static bool plan(void *self, const double pose[3], double now) { return navigator_plan(self, pose, now); }

static void control(void *self, const double pose[3], const double twist[2], double now, double out[2]) {
    navigator_control(self, pose, twist, now, out);
}

static long control_steps(const void *self) { return ((const navigator *)self)->local_plan.rollouts.rollout_steps; }

planner_interface navigator_interface(navigator *n) {
    return (planner_interface){
        .self = n,
        .beams = (int)n->set.beams,
        .add_scan = add_scan,
        .update_local = update_local,
        .update_global = update_global,
        .plan = plan,
        .control = control,
        .control_steps = control_steps,
    };
}
