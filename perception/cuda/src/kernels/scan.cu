// The inside of a Mamba block: causal convolution, selective scan with its gate, and their gradients; see `Selective` of the training on the
// CPU for the formulas.
//
// The scan walks the tokens in chunks. A block owns 32 channels of an image, four threads a channel, each with a quarter of the states
// in registers; a chunk's inputs lie in shared memory. For the gradients, the forward pass leaves the states before each chunk, from
// which the backward pass computes those inside again.

#define CHUNK 16
#define CHANNELS 32
// Threads of a channel, and states of each.
#define LANES 4
#define STATES 4
#define THREADS (CHANNELS * LANES)
// Numbers of a chunk [CHUNK, CHANNELS] that a thread prepares: those of tokens `threadIdx.x / CHANNELS + LANES * j`, all of one channel.
#define SHARE 4
#define MOST_TAPS 4
#define LOG2_E 1.44269504f

// u = silu(convolution of x), in the order of the scan: [images, tokens, inner] from the first half of xz [images, tokens, 2 inner].
KERNEL causal(
    real *__restrict__ u, const real *__restrict__ xz, const float *__restrict__ taps, const float *__restrict__ bias,
    const int *__restrict__ order, unsigned count, unsigned tokens, unsigned inner, unsigned tap_count
) {
    if (inner % 4 == 0 && tap_count == 4) {
        EACH(four, count / 4) {
            unsigned e = four * 4 % inner, t = four * 4 / inner % tokens, image = four * 4 / inner / tokens;
            // The taps of four channels, and the inputs of four tokens.
            Four sum = load4(bias, e), w[4];
            #pragma unroll
            for (int j = 0; j < 4; j++)
                w[j] = load4(taps, (e + j) * 4);
            #pragma unroll
            for (int k = 0; k < 4; k++) {
                int past = (int)t + k - 3;
                if (past >= 0) {
                    Four x = load4(xz, (image * tokens + order[past]) * 2 * inner + e);
                    #pragma unroll
                    for (int j = 0; j < 4; j++)
                        sum.x[j] += x.x[j] * w[j].x[k];
                }
            }
            #pragma unroll
            for (int j = 0; j < 4; j++)
                sum.x[j] *= sigmoid(sum.x[j]);
            store4(u, four * 4, sum);
        }
        return;
    }
    EACH(i, count) {
        unsigned e = i % inner, t = i / inner % tokens, image = i / inner / tokens;
        float sum = bias[e];
        for (unsigned k = 0; k < tap_count; k++) {
            int past = (int)(t + k + 1) - (int)tap_count;
            if (past >= 0)
                sum += load(xz, (image * tokens + order[past]) * 2 * inner + e) * taps[e * tap_count + k];
        }
        store(u, i, sum * sigmoid(sum));
    }
}

// Gradient by x of the causal convolution, into the first half of by_xz, from that by u; and parts of the gradients by taps and bias:
// [images, chunks, tap_count + 1, inner]. Block (x, y, z): 128 channels, chunk of tokens, image.
KERNEL causal_back(
    real *__restrict__ by_xz, float *__restrict__ parts, const real *__restrict__ by_u, const real *__restrict__ xz,
    const float *__restrict__ taps, const float *__restrict__ bias, const int *__restrict__ order, unsigned tokens,
    unsigned inner, unsigned tap_count, unsigned per_block
) {
    unsigned e = blockIdx.x * blockDim.x + threadIdx.x, image = blockIdx.z;
    if (e >= inner)
        return;
    int first = blockIdx.y * per_block, end = first + per_block < tokens ? first + per_block : tokens;
    // Taps are filled up in front with zeros to MOST_TAPS.
    const int last = MOST_TAPS - 1, missing = MOST_TAPS - (int)tap_count;
    float w[MOST_TAPS], sums[MOST_TAPS], x[MOST_TAPS], g[MOST_TAPS];
    #pragma unroll
    for (int k = 0; k < MOST_TAPS; k++) {
        w[k] = k >= missing ? taps[e * tap_count + k - missing] : 0.0f;
        sums[k] = x[k] = g[k] = 0.0f;
    }
    float offset = bias[e], bias_sum = 0.0f;
    // Token t has inputs x[t - last .. t]; its gradient reaches by_x[t - last .. t]. x[k] and g[k] are of token t - last + k.
    #pragma unroll 4
    for (int t = first - last; t < end + last; t++) {
        #pragma unroll
        for (int k = 0; k < last; k++) {
            x[k] = x[k + 1];
            g[k] = g[k + 1];
        }
        bool inside = t >= 0 && t < (int)tokens;
        x[last] = inside ? load(xz, (image * tokens + order[t]) * 2 * inner + e) : 0.0f;
        float slope = 0.0f;
        if (inside && t >= first) {
            float sum = offset;
            #pragma unroll
            for (int k = 0; k < MOST_TAPS; k++)
                sum += x[k] * w[k];
            float gate = sigmoid(sum);
            slope = load(by_u, (image * tokens + t) * inner + e) * gate * (1.0f + sum * (1.0f - gate));
        }
        g[last] = slope;
        if (t >= first && t < end) {
            bias_sum += slope;
            #pragma unroll
            for (int k = 0; k < MOST_TAPS; k++)
                sums[k] += slope * x[k];
        }
        // Token t - last has now met all tokens that it leads to: token t - last + k through tap last - k.
        int done = t - last;
        if (done >= first && done < end) {
            float by_x = 0.0f;
            #pragma unroll
            for (int k = 0; k < MOST_TAPS; k++)
                by_x += g[k] * w[last - k];
            store(by_xz, (image * tokens + order[done]) * 2 * inner + e, by_x);
        }
    }
    float *part = parts + (size_t)(image * gridDim.y + blockIdx.y) * (tap_count + 1) * inner;
    #pragma unroll
    for (int k = 0; k < MOST_TAPS; k++)
        if (k >= missing)
            part[(k - missing) * inner + e] = sums[k];
    part[tap_count * inner + e] = bias_sum;
}

// Adds the parts of `causal_back` to the gradients by taps [inner, tap_count] and bias. Threads of a block are 32 numbers by 8 shares of
// the parts.
KERNEL causal_total(
    float *__restrict__ by_taps, float *__restrict__ by_bias, const float *__restrict__ parts, unsigned count,
    unsigned inner, unsigned tap_count
) {
    __shared__ float sums[8][32];
    unsigned i = blockIdx.x * 32 + threadIdx.x % 32, share = threadIdx.x / 32, len = inner * (tap_count + 1);
    float sum = 0.0f;
    if (i < len)
        for (unsigned part = share; part < count; part += 8)
            sum += parts[part * len + i];
    sums[share][threadIdx.x % 32] = sum;
    __syncthreads();
    if (share > 0 || i >= len)
        return;
    for (unsigned k = 1; k < 8; k++)
        sum += sums[k][threadIdx.x];
    unsigned e = i % inner, k = i / inner;
    if (k < tap_count)
        by_taps[e * tap_count + k] += sum;
    else
        by_bias[e] += sum;
}

// Adds numbers of four tokens over the four threads of a channel: thread `lane` receives the sum of token `lane`.
static __device__ __forceinline__ float lane_sums(const float y[4], unsigned lane) {
    bool odd = lane & 1, upper = lane & 2;
    float a = (odd ? y[1] : y[0]) + __shfl_xor_sync(0xffffffff, odd ? y[0] : y[1], 1);
    float b = (odd ? y[3] : y[2]) + __shfl_xor_sync(0xffffffff, odd ? y[2] : y[3], 1);
    return (upper ? b : a) + __shfl_xor_sync(0xffffffff, upper ? a : b, 2);
}

// The numbers of a chunk that a thread prepares.
struct Share {
    float source[SHARE], input[SHARE], z[SHARE], g[SHARE], bc[SHARE];
    unsigned token[SHARE];
};

// Reads a thread's share of the chunk from token `start` on; `g` may be null. Tokens behind the last and channels behind the last read as
// zeros.
static __device__ __forceinline__ void fetch(
    Share *share, const real *xz, const real *u, const real *source, const real *projected, const real *g,
    const int *order, unsigned start, unsigned e, unsigned image, unsigned tokens, unsigned inner, unsigned state,
    unsigned rank
) {
    #pragma unroll
    for (int j = 0; j < SHARE; j++) {
        unsigned t = start + threadIdx.x / CHANNELS + LANES * j;
        bool inside = t < tokens && e < inner;
        unsigned at = (image * tokens + t) * inner + e;
        unsigned token = image * tokens + (inside ? order[t] : 0);
        share->token[j] = token;
        share->source[j] = inside ? load(source, at) : 0.0f;
        share->input[j] = inside ? load(u, at) : 0.0f;
        share->z[j] = inside ? load(xz, (token * 2 + 1) * inner + e) : 0.0f;
        share->g[j] = inside && g ? load(g, token * inner + e) : 0.0f;
        // Columns of B and C: 16 each, of the tokens of the chunk in turn.
        unsigned k = threadIdx.x + j * THREADS, row = start + k / 32, n = k % 16, part = k / 16 % 2;
        share->bc[j] = row < tokens && n < state
            ? load(projected, (image * tokens + row) * (rank + 2 * state) + rank + part * state + n) : 0.0f;
    }
}

// The scan with skip and gate: out [images, tokens, inner] in the order of the tokens. `source` is the product that leads to the step
// sizes, without their bias; `projected` has rows of `rank + 2 state` numbers, with B from `rank` on and then C. `before` receives the
// states before each chunk, [images, chunks, inner, state], if it is not null. Block (x, y): 32 channels, image.
KERNEL __launch_bounds__(THREADS) scan(
    real *__restrict__ out, float *__restrict__ before, const real *__restrict__ xz, const real *__restrict__ u,
    const real *__restrict__ source, const float *__restrict__ step_bias, const real *__restrict__ projected,
    const float *__restrict__ a_log, const float *__restrict__ skip, const int *__restrict__ order, unsigned tokens,
    unsigned inner, unsigned state, unsigned rank
) {
    __shared__ float steps[CHUNK][CHANNELS], driven[CHUNK][CHANNELS], results[CHUNK][CHANNELS];
    __shared__ Four bc[CHUNK][2 * LANES];
    unsigned first = blockIdx.x * CHANNELS, image = blockIdx.y, chunks = (tokens + CHUNK - 1) / CHUNK;
    unsigned channel = threadIdx.x / LANES, lane = threadIdx.x % LANES, e = first + channel;
    // The channel of this thread's share.
    unsigned own = threadIdx.x % CHANNELS, own_e = first + own, own_row = threadIdx.x / CHANNELS;
    float own_bias = own_e < inner ? step_bias[own_e] : 0.0f, own_skip = own_e < inner ? skip[own_e] : 0.0f;
    float decay[STATES], hidden[STATES];
    #pragma unroll
    for (int n = 0; n < STATES; n++) {
        unsigned k = lane * STATES + n;
        decay[n] = e < inner && k < state ? -expf(a_log[e * state + k]) * LOG2_E : 0.0f;
        hidden[n] = 0.0f;
    }
    Share next;
    fetch(&next, xz, u, source, projected, nullptr, order, 0, own_e, image, tokens, inner, state, rank);
    for (unsigned start = 0; start < tokens; start += CHUNK) {
        Share share = next;
        #pragma unroll
        for (int j = 0; j < SHARE; j++) {
            unsigned t = own_row + LANES * j;
            // A token behind the last has step zero and no input: it changes nothing.
            float step = start + t < tokens ? softplus(share.source[j] + own_bias) : 0.0f;
            steps[t][own] = step;
            driven[t][own] = step * share.input[j];
            ((float *)bc)[threadIdx.x + j * THREADS] = share.bc[j];
        }
        if (before && e < inner) {
            #pragma unroll
            for (int n = 0; n < STATES; n++)
                if (lane * STATES + n < state)
                    before[((image * chunks + start / CHUNK) * inner + e) * state + lane * STATES + n] = hidden[n];
        }
        __syncthreads();
        // The next chunk is on its way while this one is computed.
        if (start + CHUNK < tokens)
            fetch(&next, xz, u, source, projected, nullptr, order, start + CHUNK, own_e, image, tokens, inner, state, rank);
        #pragma unroll
        for (int t = 0; t < CHUNK; t += 4) {
            float y[4];
            #pragma unroll
            for (int j = 0; j < 4; j++) {
                float step = steps[t + j][channel], drive = driven[t + j][channel];
                Four b = bc[t + j][lane], c = bc[t + j][LANES + lane];
                y[j] = 0.0f;
                #pragma unroll
                for (int n = 0; n < STATES; n++) {
                    hidden[n] = exp2f(step * decay[n]) * hidden[n] + drive * b.x[n];
                    y[j] += hidden[n] * c.x[n];
                }
            }
            results[t + lane][channel] = lane_sums(y, lane);
        }
        __syncthreads();
        #pragma unroll
        for (int j = 0; j < SHARE; j++) {
            unsigned t = own_row + LANES * j;
            if (start + t < tokens && own_e < inner) {
                float z = share.z[j], y = results[t][own] + share.input[j] * own_skip;
                store(out, share.token[j] * inner + own_e, y * z * sigmoid(z));
            }
        }
    }
}

// Gradients of `scan`: by_u and by_source [images, tokens, inner], the second half of by_xz, and parts of the other gradients:
// by_bc [blocks, images, tokens, 2 state] over the channels of a block, by_a [images, inner, state], by_skip [images, inner].
KERNEL __launch_bounds__(THREADS) scan_back(
    real *__restrict__ by_xz, real *__restrict__ by_u, real *__restrict__ by_source, float *__restrict__ by_bc,
    float *__restrict__ by_a, float *__restrict__ by_skip, const real *__restrict__ g, const float *__restrict__ before,
    const real *__restrict__ xz, const real *__restrict__ u, const real *__restrict__ source,
    const float *__restrict__ step_bias, const real *__restrict__ projected, const float *__restrict__ a_log,
    const float *__restrict__ skip, const int *__restrict__ order, unsigned tokens, unsigned inner, unsigned state,
    unsigned rank
) {
    __shared__ float steps[CHUNK][CHANNELS], inputs[CHUNK][CHANNELS], slopes[CHUNK][CHANNELS];
    // The scan's results, and the gradients by what drives it and by its step sizes.
    __shared__ float results[CHUNK][CHANNELS], by_driven[CHUNK][CHANNELS], by_step[CHUNK][CHANNELS];
    __shared__ Four bc[CHUNK][2 * LANES];
    // States of a chunk, then the gradients by them. Four more than threads, so that sums over channels read from different banks.
    __shared__ float kept[CHUNK][STATES][THREADS + 4];
    unsigned first = blockIdx.x * CHANNELS, image = blockIdx.y, chunks = (tokens + CHUNK - 1) / CHUNK;
    unsigned channel = threadIdx.x / LANES, lane = threadIdx.x % LANES, e = first + channel;
    unsigned own = threadIdx.x % CHANNELS, own_e = first + own, own_row = threadIdx.x / CHANNELS;
    float own_bias = own_e < inner ? step_bias[own_e] : 0.0f, own_skip = own_e < inner ? skip[own_e] : 0.0f;
    float decay[STATES], by_hidden[STATES], by_decay[STATES], states[STATES], skip_sum = 0.0f;
    #pragma unroll
    for (int n = 0; n < STATES; n++) {
        unsigned k = lane * STATES + n;
        decay[n] = e < inner && k < state ? -expf(a_log[e * state + k]) : 0.0f;
        by_hidden[n] = by_decay[n] = 0.0f;
    }
    Share next;
    unsigned last = (chunks - 1) * CHUNK;
    fetch(&next, xz, u, source, projected, g, order, last, own_e, image, tokens, inner, state, rank);
    for (int chunk = (int)chunks - 1; chunk >= 0; chunk--) {
        unsigned start = chunk * CHUNK;
        Share share = next;
        #pragma unroll
        for (int j = 0; j < SHARE; j++) {
            unsigned t = own_row + LANES * j;
            steps[t][own] = start + t < tokens ? softplus(share.source[j] + own_bias) : 0.0f;
            inputs[t][own] = share.input[j];
            slopes[t][own] = share.g[j] * share.z[j] * sigmoid(share.z[j]);
            ((float *)bc)[threadIdx.x + j * THREADS] = share.bc[j];
        }
        float hidden[STATES];
        #pragma unroll
        for (int n = 0; n < STATES; n++) {
            unsigned k = lane * STATES + n;
            hidden[n] = states[n]
                = e < inner && k < state ? before[((image * chunks + chunk) * inner + e) * state + k] : 0.0f;
        }
        __syncthreads();
        if (chunk > 0)
            fetch(&next, xz, u, source, projected, g, order, start - CHUNK, own_e, image, tokens, inner, state, rank);
        // The states of the chunk, and the scan's results, which the gate needs.
        #pragma unroll
        for (int t = 0; t < CHUNK; t += 4) {
            float y[4];
            #pragma unroll
            for (int j = 0; j < 4; j++) {
                float step = steps[t + j][channel], drive = step * inputs[t + j][channel];
                Four b = bc[t + j][lane], c = bc[t + j][LANES + lane];
                y[j] = 0.0f;
                #pragma unroll
                for (int n = 0; n < STATES; n++) {
                    hidden[n] = exp2f(step * decay[n] * LOG2_E) * hidden[n] + drive * b.x[n];
                    kept[t + j][n][threadIdx.x] = hidden[n];
                    y[j] += hidden[n] * c.x[n];
                }
            }
            results[t + lane][channel] = lane_sums(y, lane);
        }
        __syncthreads();
        // By C: the slope times the state, summed over the channels.
        for (unsigned k = threadIdx.x; k < CHUNK * LANES * STATES; k += THREADS) {
            unsigned t = k / (LANES * STATES), n = k % (LANES * STATES);
            float sum = 0.0f;
            #pragma unroll 8
            for (unsigned c = 0; c < CHANNELS; c++)
                sum += slopes[t][c] * kept[t][n % STATES][c * LANES + n / STATES];
            if (start + t < tokens && n < state)
                by_bc[((blockIdx.x * gridDim.y + image) * tokens + start + t) * 2 * state + state + n] = sum;
        }
        __syncthreads();
        #pragma unroll
        for (int t = CHUNK - 4; t >= 0; t -= 4) {
            float of_driven[4], of_step[4];
            #pragma unroll
            for (int j = 3; j >= 0; j--) {
                float step = steps[t + j][channel], slope = slopes[t + j][channel];
                Four b = bc[t + j][lane], c = bc[t + j][LANES + lane];
                of_driven[j] = of_step[j] = 0.0f;
                #pragma unroll
                for (int n = 0; n < STATES; n++) {
                    float past = t + j > 0 ? kept[t + j > 0 ? t + j - 1 : 0][n][threadIdx.x] : states[n];
                    float by_now = slope * c.x[n] + by_hidden[n];
                    kept[t + j][n][threadIdx.x] = by_now;
                    of_driven[j] += by_now * b.x[n];
                    by_hidden[n] = by_now * exp2f(step * decay[n] * LOG2_E);
                    float by_exponent = by_hidden[n] * past;
                    of_step[j] += by_exponent * decay[n];
                    by_decay[n] += by_exponent * step;
                }
            }
            by_driven[t + lane][channel] = lane_sums(of_driven, lane);
            by_step[t + lane][channel] = lane_sums(of_step, lane);
        }
        __syncthreads();
        // By B: the gradient by the state times what drives it, summed over the channels.
        for (unsigned k = threadIdx.x; k < CHUNK * LANES * STATES; k += THREADS) {
            unsigned t = k / (LANES * STATES), n = k % (LANES * STATES);
            float sum = 0.0f;
            #pragma unroll 8
            for (unsigned c = 0; c < CHANNELS; c++)
                sum += steps[t][c] * inputs[t][c] * kept[t][n % STATES][c * LANES + n / STATES];
            if (start + t < tokens && n < state)
                by_bc[((blockIdx.x * gridDim.y + image) * tokens + start + t) * 2 * state + n] = sum;
        }
        #pragma unroll
        for (int j = 0; j < SHARE; j++) {
            unsigned t = own_row + LANES * j;
            if (start + t < tokens && own_e < inner) {
                float step = steps[t][own], input = share.input[j], slope = slopes[t][own];
                unsigned at = (image * tokens + start + t) * inner + own_e;
                store(by_u, at, by_driven[t][own] * step + slope * own_skip);
                // The slope of softplus is 1 - e^-softplus.
                store(by_source, at, (by_driven[t][own] * input + by_step[t][own]) * (1.0f - expf(-step)));
                skip_sum += slope * input;
                float z = share.z[j], gate = sigmoid(z), y = results[t][own] + input * own_skip;
                float by_z = share.g[j] * y * gate * (1.0f + z * (1.0f - gate));
                store(by_xz, (share.token[j] * 2 + 1) * inner + own_e, by_z);
            }
        }
        __syncthreads();
    }
    if (e < inner) {
        #pragma unroll
        for (int n = 0; n < STATES; n++)
            if (lane * STATES + n < state)
                // The slope of A = -exp(A_log) is A itself.
                by_a[(image * inner + e) * state + lane * STATES + n] = by_decay[n] * decay[n];
    }
    results[own_row][own] = skip_sum;
    __syncthreads();
    if (own_row == 0 && own_e < inner)
        by_skip[image * inner + own_e] = results[0][own] + results[1][own] + results[2][own] + results[3][own];
}

// Writes the sums of the parts of by_bc over the blocks into the columns from `rank` on of by_projected, which has rows of `columns`.
KERNEL scan_bc_total(
    real *__restrict__ by_projected, const float *__restrict__ parts, unsigned blocks, unsigned rows, unsigned width,
    unsigned rank
) {
    EACH(i, rows * width) {
        float sum = 0.0f;
        for (unsigned k = 0; k < blocks; k++)
            sum += parts[(size_t)k * rows * width + i];
        store(by_projected, i / width * (rank + width) + rank + i % width, sum);
    }
}
