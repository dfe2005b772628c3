// Times Embree 3 on the triangles and rays that `ray_bench --dump` wrote, one thread, and compares depths. Prints:
// view, rays, hits, CPU seconds with single rays, CPU seconds with packets of 8, worst difference of depth in mm among
// all but the 0.1 % worst rays (those graze silhouettes).
#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <limits>
#include <string>
#include <vector>

static double cpu() {
    timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

template <class T> static std::vector<T> take(FILE *in, size_t n) {
    std::vector<T> values(n);
    if (fread(values.data(), sizeof(T), n, in) != n) {
        fprintf(stderr, "unexpected end of file\n");
        exit(1);
    }
    return values;
}

struct Ray { float direction[3], depth; };

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: embree VIEW FILE\n");
        return 2;
    }
    FILE *in = fopen(argv[2], "rb");
    if (!in) {
        perror(argv[2]);
        return 1;
    }
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene top = rtcNewScene(device);
    rtcSetSceneBuildQuality(top, RTC_BUILD_QUALITY_HIGH);
    const uint32_t instances = take<uint32_t>(in, 1)[0];
    for (uint32_t i = 0; i < instances; ++i) {
        auto pose = take<float>(in, 12);
        auto counts = take<uint32_t>(in, 2);
        auto vertices = take<float>(in, 3 * size_t(counts[0]));
        auto faces = take<uint32_t>(in, 3 * size_t(counts[1]));
        RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_HIGH);
        void *v = rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, counts[0]);
        std::copy(vertices.begin(), vertices.end(), static_cast<float *>(v));
        void *f = rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, counts[1]);
        std::copy(faces.begin(), faces.end(), static_cast<uint32_t *>(f));
        rtcCommitGeometry(mesh);
        if (instances == 1) {
            // A single object needs no instance: its pose is a translation, which goes into the vertices.
            for (uint32_t k = 0; k < counts[0]; ++k)
                for (int axis = 0; axis < 3; ++axis) static_cast<float *>(v)[3 * k + axis] += pose[4 * axis + 3];
            rtcUpdateGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0);
            rtcCommitGeometry(mesh);
            rtcAttachGeometry(top, mesh);
        } else {
            RTCScene scene = rtcNewScene(device);
            rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
            rtcAttachGeometry(scene, mesh);
            rtcCommitScene(scene);
            RTCGeometry instance = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
            rtcSetGeometryInstancedScene(instance, scene);
            rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, pose.data());
            rtcCommitGeometry(instance);
            rtcAttachGeometry(top, instance);
        }
    }
    rtcCommitScene(top);
    auto size = take<uint32_t>(in, 2);
    const size_t width = size[0], height = size[1];
    auto origin = take<float>(in, 3);
    auto rays = take<Ray>(in, width * height);
    std::vector<float> depth(width * height), u(width * height), v(width * height);
    std::vector<uint32_t> primitive(width * height), instance(width * height);
    RTCIntersectContext context;
    const float infinity = std::numeric_limits<float>::infinity();

    auto singles = [&] {
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        for (size_t k = 0; k < rays.size(); ++k) {
            RTCRayHit ray;
            ray.ray = {origin[0], origin[1], origin[2], 0, rays[k].direction[0], rays[k].direction[1],
                       rays[k].direction[2], 0, infinity, ~0u, 0, 0};
            ray.hit.geomID = ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(top, &context, &ray);
            depth[k] = ray.ray.tfar, primitive[k] = ray.hit.primID, instance[k] = ray.hit.instID[0];
            u[k] = ray.hit.u, v[k] = ray.hit.v;
        }
    };
    auto packets = [&] {
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        alignas(32) int valid[8] = {-1, -1, -1, -1, -1, -1, -1, -1};
        // Tiles of 4 x 2 pixels; both images are a whole number of them.
        for (size_t row = 0; row < height; row += 2)
            for (size_t column = 0; column < width; column += 4) {
                RTCRayHit8 packet;
                for (int k = 0; k < 8; ++k) {
                    const Ray &ray = rays[(row + k / 4) * width + column + k % 4];
                    packet.ray.org_x[k] = origin[0], packet.ray.org_y[k] = origin[1], packet.ray.org_z[k] = origin[2];
                    packet.ray.dir_x[k] = ray.direction[0], packet.ray.dir_y[k] = ray.direction[1];
                    packet.ray.dir_z[k] = ray.direction[2];
                    packet.ray.tnear[k] = packet.ray.time[k] = 0, packet.ray.tfar[k] = infinity;
                    packet.ray.mask[k] = ~0u, packet.ray.flags[k] = 0;
                    packet.hit.geomID[k] = packet.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
                }
                rtcIntersect8(valid, top, &context, &packet);
                for (int k = 0; k < 8; ++k) {
                    const size_t pixel = (row + k / 4) * width + column + k % 4;
                    depth[pixel] = packet.ray.tfar[k], primitive[pixel] = packet.hit.primID[k];
                    instance[pixel] = packet.hit.instID[0][k], u[pixel] = packet.hit.u[k], v[pixel] = packet.hit.v[k];
                }
            }
    };
    auto fastest = [&](auto cast) {
        double best = 1e9;
        const double end = cpu() + 0.7;
        while (cpu() < end) {
            const double start = cpu();
            cast();
            best = std::min(best, cpu() - start);
        }
        return best;
    };
    const double one = fastest(singles), eight = fastest(packets);
    std::vector<double> differences;
    size_t hits = 0;
    for (size_t k = 0; k < rays.size(); ++k) {
        hits += std::isfinite(depth[k]);
        const bool both = std::isfinite(depth[k]) && std::isfinite(rays[k].depth);
        const bool neither = !std::isfinite(depth[k]) && !std::isfinite(rays[k].depth);
        differences.push_back(both ? std::abs(depth[k] - rays[k].depth) * 1e3 : neither ? 0.0 : infinity);
    }
    std::sort(differences.begin(), differences.end());
    printf("%s %zu %zu %.6f %.6f %.6f\n", argv[1], rays.size(), hits, one, eight,
           differences[differences.size() * 999 / 1000]);
}
