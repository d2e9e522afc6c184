#define _POSIX_C_SOURCE 199309L  // clock_gettime
#include "loop.h"

#include <math.h>
#include <string.h>
#include <time.h>

#include "trig.h"

#define NEVER (INT64_C(1) << 60)

static double clock_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void spent(navigation_loop *l, loop_stage stage, double since) {
    l->seconds[stage] += clock_s() - since;
    l->calls[stage] += 1;
}

void rate_start(rate *r, int period_ms, int phase_ms) { *r = (rate){period_ms, phase_ms, phase_ms}; }

void rate_wait(rate *r, int64_t until_ms) { r->due = until_ms; }

void rate_finish(rate *r, int64_t now_ms) {
    const int64_t expected = r->grid + r->period;
    r->grid = now_ms > expected + r->period ? now_ms : expected;  // a whole period late: forget the old grid
    r->due = expected > now_ms ? expected : now_ms;
}

// Index of the newest that has arrived, -1 for none.
static int arrived(const loop_queue *q, int64_t now_ms) {
    int found = -1;
    for (int i = 0; i < q->count; ++i) {
        if (q->stamp[(q->first + i) % LOOP_QUEUE].time_ms + q->delay_ms > now_ms) break;
        found = i;
    }
    return found;
}

static void drop(loop_queue *q, int n) {
    q->first = (q->first + n) % LOOP_QUEUE;
    q->count -= n;
}

static void put(loop_queue *q, const loop_stamp *s) {
    const int newest = arrived(q, s->time_ms);
    if (newest > 0) drop(q, newest);
    q->stamp[(q->first + q->count) % LOOP_QUEUE] = *s;
    q->count += 1;
}

static bool take(loop_queue *q, int64_t now_ms, loop_stamp *to) {
    const int newest = arrived(q, now_ms);
    if (newest < 0) return false;
    *to = q->stamp[(q->first + newest) % LOOP_QUEUE];
    drop(q, newest + 1);
    return true;
}

// False where the robot may touch something before then.
static bool drive_until(navigation_loop *l, int64_t time_ms) {
    if (time_ms <= l->now_ms) return true;
    const double start = clock_s();
    vehicle_command(&l->body->state, l->command[0], l->command[1], l->now_ms - l->received_ms);
    l->now_ms += robot_drive(l->body, (int)(time_ms - l->now_ms));
    spent(l, STAGE_PHYSICS, start);
    l->contact_ms = (int)(time_ms - l->now_ms < CONTACT_MS ? time_ms - l->now_ms : CONTACT_MS);
    return l->contact_ms == 0;
}

// The lidar fires and odometry is published, on the same 50 Hz grid.
static bool sense(navigation_loop *l) {
    const vehicle_state *s = &l->body->state;
    const loop_stamp stamp = {l->now_ms,
                              {s->x, s->y, s->yaw},
                              {s->odom_x - l->origin[0], s->odom_y - l->origin[1], s->yaw + s->odom_yaw_error},
                              {s->odom_v, s->odom_w}};
    l->newest = stamp;
    put(&l->scans, &stamp);
    put(&l->estimates, &stamp);
    l->scan_due_ms = l->now_ms + l->timing.scan_period_ms;
    return isfinite((float)s->x) && isfinite((float)s->y) && isfinite((float)s->yaw) && isfinite((float)s->odom_x) &&
           isfinite((float)s->odom_y) && isfinite((float)s->odom_v) && isfinite((float)s->odom_w);
}

static void give_scan(navigation_loop *l, int64_t now_ms) {
    loop_stamp s;
    if (!take(&l->scans, now_ms, &s)) return;
    const double start = clock_s();
    const robot *body = l->body;
    const double yaw = s.pose[2];
    double sine, cosine;
    trig_sincos(yaw, &sine, &cosine);
    const double from[3] = {s.pose[0] + l->lidar_x * cosine, s.pose[1] + l->lidar_x * sine, yaw};
    lidar_cast(l->sensor, from, body->cylinders, body->count, body->state.seed, (uint64_t)s.time_ms, l->ranges);
    spent(l, STAGE_LIDAR, start);
    l->planner.add_scan(l->planner.self, l->ranges, s.pose_odom);
}

static int64_t delay_ms(const navigation_loop *l, double work_ms) {
    return (int64_t)ceil(work_ms * l->timing.cpu_factor);
}

static int64_t next_work_ms(const navigation_loop *l) {
    int64_t next = l->planning ? l->plan_done_ms : l->plan.due;
    if (l->local.due < next) next = l->local.due;
    if (l->global.due < next) next = l->global.due;
    return l->control.due < next ? l->control.due : next;
}

static void run_control(navigation_loop *l, int64_t now_ms) {
    const double start = clock_s();
    double out[2];
    l->planner.control(l->planner.self, l->estimate.pose_odom, l->estimate.twist, (double)now_ms / 1000.0, out);
    const double steps = (double)l->planner.control_steps(l->planner.self);
    const double work_ms = l->timing.control_base_ms + l->timing.control_us_per_step * steps / 1000.0;
    l->control_done_ms = now_ms + delay_ms(l, work_ms);
    l->flying[(l->flying_first + l->flying_count) % LOOP_QUEUE] =
        (loop_command){l->control_done_ms + l->timing.command_delay_ms, out[0], out[1]};
    l->flying_count += 1;
    rate_finish(&l->control, l->control_done_ms);
    spent(l, STAGE_CONTROL, start);
}

// A map's cycle: the newest scan, then the map, unless whoever reads it holds it until later.
static void run_map(navigation_loop *l, int64_t now_ms, rate *cycle, int64_t held_until_ms, loop_stage stage,
                    void (*update)(void *, const double *)) {
    if (now_ms < held_until_ms) {
        rate_wait(cycle, held_until_ms);
        return;
    }
    give_scan(l, now_ms);
    const double start = clock_s();
    update(l->planner.self, l->estimate.pose_odom);
    rate_finish(cycle, now_ms);
    spent(l, stage, start);
}

// The map, plan or control cycle that is due.
static void compute(navigation_loop *l, int64_t now_ms) {
    take(&l->estimates, now_ms, &l->estimate);
    if (now_ms == l->local.due) {
        run_map(l, now_ms, &l->local, l->control_done_ms, STAGE_LOCAL_MAP, l->planner.update_local);
    } else if (now_ms == l->global.due) {
        const int64_t held_until_ms = l->planning ? l->plan_done_ms : 0;
        run_map(l, now_ms, &l->global, held_until_ms, STAGE_GLOBAL_MAP, l->planner.update_global);
    } else if (!l->planning && now_ms == l->plan.due) {
        // The map is held while planning, so computing at the end from the pose at the start is the same.
        memcpy(l->planning_from, l->estimate.pose_odom, sizeof l->planning_from);
        l->planning = 1;
        l->plan_done_ms = now_ms + delay_ms(l, l->timing.plan_ms);
    } else if (l->planning && now_ms == l->plan_done_ms) {
        const double start = clock_s();
        l->planner.plan(l->planner.self, l->planning_from, NAN);
        l->planning = 0;
        rate_finish(&l->plan, now_ms);
        spent(l, STAGE_PLAN, start);
    } else {
        run_control(l, now_ms);
    }
}

void loop_reset(navigation_loop *l, const double origin[2], const loop_phases *phases) {
    const loop_timing *t = &l->timing;
    l->origin[0] = origin[0];
    l->origin[1] = origin[1];
    l->now_ms = l->received_ms = l->scan_due_ms = l->control_done_ms = 0;
    l->plan_done_ms = NEVER;
    l->planning = 0;
    l->command[0] = l->command[1] = 0.0;
    l->flying_first = l->flying_count = 0;
    l->scans.first = l->scans.count = l->estimates.first = l->estimates.count = 0;
    l->estimates.delay_ms = t->odometry_delay_ms + phases->filter_ms;
    // A scan waits for the transform of its stamp.
    l->scans.delay_ms = t->scan_delay_ms > l->estimates.delay_ms ? t->scan_delay_ms : l->estimates.delay_ms;
    rate_start(&l->local, t->local_map_period_ms, phases->local_map_ms);
    rate_start(&l->global, t->global_map_period_ms, phases->global_map_ms);
    rate_start(&l->plan, t->plan_period_ms, phases->plan_ms);
    rate_start(&l->control, t->control_period_ms, phases->control_ms);
    l->work_due_ms = next_work_ms(l);
    sense(l);
    l->estimate = l->newest;
}

// Simultaneous events in the order of the data's way, so that ideal timing is one synchronous tick.
loop_pause loop_run(navigation_loop *l, int64_t end_ms) {
    for (;;) {
        const int64_t arrival_ms = l->flying_count ? l->flying[l->flying_first].due_ms : NEVER;
        const int64_t scan_ms = l->scan_due_ms;
        const int64_t work_ms = l->work_due_ms;
        if (arrival_ms <= scan_ms && arrival_ms <= work_ms && arrival_ms < end_ms) {
            if (!drive_until(l, arrival_ms)) return LOOP_CONTACT;
            const loop_command *c = &l->flying[l->flying_first];
            l->command[0] = c->v;
            l->command[1] = c->w;
            l->received_ms = arrival_ms;
            l->flying_first = (l->flying_first + 1) % LOOP_QUEUE;
            l->flying_count -= 1;
        } else if (scan_ms <= work_ms && scan_ms < end_ms) {
            if (!drive_until(l, scan_ms)) return LOOP_CONTACT;
            if (!sense(l)) return LOOP_BROKEN;
            trial_update(&l->test, l->body, l->now_ms);
            if (l->test.over) return LOOP_OVER;
            if (l->watched) return LOOP_SAMPLED;
        } else if (work_ms < end_ms) {
            compute(l, work_ms);
            if (l->planner.failed && l->planner.failed(l->planner.self)) return LOOP_FAILED;
            l->work_due_ms = next_work_ms(l);
        } else {
            if (!drive_until(l, end_ms)) return LOOP_CONTACT;
            trial_update(&l->test, l->body, l->now_ms);
            return l->test.over ? LOOP_OVER : LOOP_ENDED;
        }
    }
}
