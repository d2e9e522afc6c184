#include "local_planner.h"

void local_planner_reset(local_planner *l) {
    rollout_reset(&l->rollouts);
    l->plan.first = l->plan.count = 0;
    l->rotating_to_goal = l->reached_goal = false;
    l->best = NULL;
    l->best_cost = -1;
    l->local_first = l->local_count = 0;
}

bool local_planner_set_plan(local_planner *l, const double *xy, int n, double end_yaw) {
    if (n > l->plan.capacity) return false;
    for (int i = 0; i < n; ++i) {
        l->plan.x[i] = xy[2 * i];
        l->plan.y[i] = xy[2 * i + 1];
    }
    l->plan.first = 0;
    l->plan.count = n;
    l->plan.end_yaw = end_yaw;
    l->reached_goal = false;
    return true;
}

static double square_distance(const plan_store *plan, int i, const double pose[3]) {
    const double dx = pose[0] - plan->x[i];
    const double dy = pose[1] - plan->y[i];
    return dx * dx + dy * dy;
}

// transformGlobalPlan, then prunePlan: the points of the first stretch inside half the map's width, and one more;
// what lies more than a metre behind is dropped for good.
static void cut_plan(local_planner *l, const grid_frame *frame, const double pose[3]) {
    plan_store *plan = &l->plan;
    const double limit = fmax(frame->w * frame->res / 2.0, frame->h * frame->res / 2.0);
    const int end = plan->first + plan->count;
    int i = plan->first;
    double square = 0;
    for (; i < end; ++i) {
        square = square_distance(plan, i, pose);
        if (square <= limit * limit) break;
    }
    int first = i;
    while (i < end && square <= limit * limit) square = square_distance(plan, i++, pose);
    int drop = 0;
    while (first + drop < i && !(square_distance(plan, first + drop, pose) < 1)) ++drop;
    // As many from the front of the global plan, which is not the same place when its start was skipped.
    plan->first += drop;
    plan->count -= drop;
    l->local_first = first + drop;
    l->local_count = i - first - drop;
}

static double sign(double v) { return v < 0 ? -1.0 : 1.0; }

static bool stop_with_acc_limits(local_planner *l, const double pose[3], double v, double w, double out[2]) {
    const planner_settings *s = l->rollouts.set;
    const double period = 1.0 / s->controller_frequency;
    const double vs = sign(v) * fmax(0.0, fabs(v) - s->acc_lim_x * period);
    const double ws = sign(w) * fmax(0.0, fabs(w) - s->acc_lim_theta * period);
    if (!rollout_check(&l->rollouts, pose[0], pose[1], pose[2], v, w, vs, ws)) return false;
    out[0] = vs;
    out[1] = ws;
    return true;
}

static bool rotate_to_goal(local_planner *l, const double pose[3], double v, double w, double goal_yaw, double out[2]) {
    const planner_settings *s = l->rollouts.set;
    const double period = 1.0 / s->controller_frequency;
    const double diff = shortest_angle(pose[2], goal_yaw);
    double ws = diff > 0 ? fmin(s->max_rotational_vel, fmax(s->min_in_place_vel_theta, diff))
                         : fmax(-s->max_rotational_vel, fmin(-s->min_in_place_vel_theta, diff));
    const double most = fabs(w) + s->acc_lim_theta * period;
    const double least = fabs(w) - s->acc_lim_theta * period;
    ws = sign(ws) * fmin(fmax(fabs(ws), least), most);
    ws = sign(ws) * fmin(sqrt(2 * s->acc_lim_theta * fabs(diff)), fabs(ws));
    if (!rollout_check(&l->rollouts, pose[0], pose[1], pose[2], v, w, 0, ws)) return false;
    out[1] = ws;
    return true;
}

static const rollout *find_best(local_planner *l, const double pose[3], double v, double w) {
    // Eigen::Vector3f in findBestPath.
    const float x = (float)pose[0];
    const float y = (float)pose[1];
    const float yaw = (float)pose[2];
    const float fv = (float)v;
    const float fw = (float)w;
    l->best = rollout_best(&l->rollouts, l->plan.x + l->local_first, l->plan.y + l->local_first, l->local_count, x, y,
                           yaw, fv, fw);
    l->best_cost = l->best->cost;
    return l->best;
}

bool local_planner_command(local_planner *l, const grid_frame *frame, const uint8_t *cost, const double pose_in[3],
                           const double twist[2], double out[2]) {
    const planner_settings *s = l->rollouts.set;
    const double pose[3] = {pose_in[0], pose_in[1], yaw_through_quaternion(pose_in[2])};
    const double v = twist[0];
    const double w = yaw_through_quaternion(twist[1]);
    l->rollouts.frame = *frame;
    l->rollouts.cost = cost;
    l->rollouts.rollouts = l->rollouts.rollout_steps = 0;
    l->best = NULL;
    l->best_cost = -1;
    l->local_count = 0;
    out[0] = out[1] = 0;
    if (l->plan.count == 0) return false;
    cut_plan(l, frame, pose);
    if (l->local_count == 0) return false;

    const int last = l->local_first + l->local_count - 1;
    const bool plan_end = last == l->plan.first + l->plan.count - 1;
    const double goal_yaw = plan_end ? yaw_through_quaternion(l->plan.end_yaw) : 0.0;
    if (hypot(l->plan.x[last] - pose[0], l->plan.y[last] - pose[1]) <= s->xy_goal_tolerance) {
        if (fabs(shortest_angle(pose[2], goal_yaw)) <= s->yaw_goal_tolerance) {
            l->rotating_to_goal = false;
            l->reached_goal = true;
            l->local_count = 0;
            return true;
        }
        find_best(l, pose, v, w);  // for the state it leaves behind; the command comes from below
        const bool stopped = fabs(twist[1]) <= s->rot_stopped_velocity && fabs(v) <= s->trans_stopped_velocity;
        if (!l->rotating_to_goal && !stopped) return stop_with_acc_limits(l, pose, v, w, out);
        l->rotating_to_goal = true;
        return rotate_to_goal(l, pose, v, w, goal_yaw, out);
    }
    const rollout *best = find_best(l, pose, v, w);
    if (best->cost < 0) return false;
    out[0] = best->v;
    out[1] = yaw_through_quaternion(best->w);
    return true;
}
