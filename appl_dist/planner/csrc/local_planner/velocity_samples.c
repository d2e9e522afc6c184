#include "velocity_samples.h"

#include "wide.h"

// simulate_steps of all lanes.
ALWAYS_INLINE void count_steps(sample_block *b, const planner_settings *set, int steps_max) {
    const double sim_time = set->sim_time;
    const double apart = set->sim_granularity;
    const double turn_apart = set->angular_sim_granularity;
    for (int i = 0; i < SAMPLE_LANES; ++i) {
        const double along = fabs(b->v[i]) * sim_time / apart;
        const double round = fabs(b->w[i]) / turn_apart;
        double n = (round > along ? round : along) + 0.5;
        n = n < steps_max ? n : steps_max;
        n = n > 1 ? n : 1;
        b->steps[i] = (int32_t)n;
        b->dt[i] = sim_time / b->steps[i];
    }
}

// Steps until both velocities are reached; a lane that is there takes steps of no time. False when some lane is not
// there after ARC_FROM_MAX.
ALWAYS_INLINE bool speed_up(sample_block *b, const planner_settings *set, const motion *m) {
    const double acc_x = set->acc_lim_x;
    const double acc_theta = set->acc_lim_theta;
    double speed[SAMPLE_LANES], rate[SAMPLE_LANES], from[SAMPLE_LANES];
    for (int i = 0; i < SAMPLE_LANES; ++i) {
        b->x[i] = m->x;
        b->y[i] = m->y;
        b->th[i] = m->th;
        speed[i] = m->v;
        rate[i] = m->w;
        from[i] = 0;
    }
    int64_t busy = 1;
    for (int k = 0; busy && k <= ACCELERATION_STEPS_MAX; ++k) {
        busy = 0;
        for (int i = 0; i < SAMPLE_LANES; ++i) {
            const double v = b->v[i];
            const double w = b->w[i];
            const double missing = fabs(v - speed[i]) + fabs(w - rate[i]);
            const double on = from[i] < b->steps[i] - 1 ? (missing > 0 ? 1.0 : 0.0) : 0.0;
            const double dt = on * b->dt[i];
            double s, c;
            rollout_arc_sincos(b->th[i], &s, &c);
            const double up = speed[i] + acc_x * dt;
            const double down = speed[i] - acc_x * dt;
            const double left = rate[i] + acc_theta * dt;
            const double right = rate[i] - acc_theta * dt;
            const double faster = up < v ? up : v;
            const double slower = down > v ? down : v;
            const double to_left = left < w ? left : w;
            const double to_right = right > w ? right : w;
            speed[i] = v >= speed[i] ? faster : slower;
            rate[i] = w >= rate[i] ? to_left : to_right;
            b->x[i] += speed[i] * c * dt;
            b->y[i] += speed[i] * s * dt;
            b->th[i] += rate[i] * dt;
            from[i] += on;
            int64_t bits;
            memcpy(&bits, &on, sizeof bits);
            busy |= bits;
        }
    }
    for (int i = 0; i < SAMPLE_LANES; ++i) b->from[i] = (int32_t)from[i];
    return !busy;
}

ALWAYS_INLINE void find_ends(sample_block *b, const grid_frame *frame) {
    const grid_frame g = *frame;
    const double per_res = 1 / g.res;
    for (int i = 0; i < SAMPLE_LANES; ++i) {
        const double turn = b->w[i] * b->dt[i];
        const double pace = b->v[i] * b->dt[i];
        const double n = b->steps[i] - 1 - b->from[i];
        double s, c, half, unused;
        rollout_arc_sincos(turn * 0.5, &s, &c);
        const double per_half = fabs(turn) > 1e-9 ? 1 / s : 0;
        rollout_arc_sincos(b->th[i] + (n - 1) * turn * 0.5, &s, &c);
        rollout_arc_sincos(n * turn * 0.5, &half, &unused);
        const double length = pace * (per_half == 0 ? n : half * per_half);
        const int32_t known =
            rollout_arc_cell(&g, per_res, b->x[i] + length * c, b->y[i] + length * s, &b->cx[i], &b->cy[i]);
        b->turn[i] = turn;
        b->pace[i] = pace;
        b->per_half[i] = per_half;
        const int32_t sane = fabs(turn) < 1 ? known : SAMPLE_NO_ARC;
        b->known[i] = b->steps[i] <= ROLLOUT_ARC_STEPS_MAX ? sane : SAMPLE_NO_ARC;
    }
}

WIDE static bool roll(sample_block *restrict b, const planner_settings *restrict set, const grid_frame *restrict frame,
                      const motion *restrict m, int steps_max) {
    count_steps(b, set, steps_max);
    const bool there = speed_up(b, set, m);
    find_ends(b, frame);
    return there;
}

void velocity_samples_rollout(sample_block *b, const rollout_planner *p, const motion *m) {
    const double large = fmax(fmax(fabs(m->x), fabs(m->y)), fmax(fabs(m->v), fmax(fabs(m->w), fabs(m->th))));
    if (roll(b, p->set, &p->frame, m, p->steps_max) && large < 5e3) return;
    for (int i = 0; i < SAMPLE_LANES; ++i) {
        b->steps[i] = simulate_steps(p, b->v[i], b->w[i]);
        b->known[i] = SAMPLE_NO_ARC;
    }
}

rollout_arc velocity_samples_arc(const sample_block *b, int i) {
    return (rollout_arc){b->v[i],    b->w[i],        b->x[i],  b->y[i],     b->th[i],  b->turn[i],
                         b->pace[i], b->per_half[i], b->dt[i], b->steps[i], b->from[i]};
}
