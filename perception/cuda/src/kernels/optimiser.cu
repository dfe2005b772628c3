// AdamW with an average of the weights, over all parameters at once; see `OptimiserState`.

// Parts of the square of the gradient's length, one per block of 256 threads.
KERNEL square_parts(float *parts, const float *gradient, unsigned count) {
    float sum = 0.0f;
    EACH(i, count) sum += gradient[i] * gradient[i];
    sum = block_sum(sum);
    if (threadIdx.x == 0)
        parts[blockIdx.x] = sum;
}

// Results of a step: its loss and the length of its gradient, from their parts. One thread.
KERNEL progress(float *result, const float *losses, unsigned loss_count, const float *squares, unsigned square_count) {
    float loss = 0.0f;
    double square = 0.0;
    for (unsigned k = 0; k < loss_count; k++)
        loss += losses[k];
    for (unsigned k = 0; k < square_count; k++)
        square += squares[k];
    result[0] = loss;
    result[1] = (float)sqrt(square);
}

// A step, unless loss or gradient are not finite. `decayed` tells which numbers belong to matrices and kernels.
KERNEL adamw(
    float *weights, float *average, float *mean, float *square, real *copy, const float *gradient,
    const unsigned char *decayed, const float *result, unsigned count, float rate, float decay, float clip,
    float beta1, float beta2, float unbiased1, float unbiased2, float keep
) {
    float length = result[1];
    if (!(fabsf(result[0]) < 3e38f) || !(length < 3e38f))
        return;
    float factor = length > clip ? clip / length : 1.0f;
    EACH(i, count) {
        float g = gradient[i] * factor, w = weights[i];
        float m = beta1 * mean[i] + (1.0f - beta1) * g;
        float v = beta2 * square[i] + (1.0f - beta2) * g * g;
        w -= (decayed[i] ? rate * decay * w : 0.0f) + rate * (m / unbiased1) / (sqrtf(v / unbiased2) + 1e-8f);
        mean[i] = m;
        square[i] = v;
        weights[i] = w;
        average[i] = keep * average[i] + (1.0f - keep) * w;
#ifdef BF16
        store(copy, i, w);
#endif
    }
}
