// The mean curvature skeleton of a closed mesh by CGAL, as an oracle for ours. A measuring tool: nothing of it is
// part of the package (CGAL's package is GPL). `mean_curvature IN.off OUT.txt` writes "v x y z" and "e a b" lines.
#include <CGAL/Polygon_mesh_processing/connected_components.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/IO/polygon_soup_io.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/extract_mean_curvature_flow_skeleton.h>

#include <fstream>
#include <iostream>

using Kernel = CGAL::Simple_cartesian<double>;
using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;
using Skeletonization = CGAL::Mean_curvature_flow_skeletonization<Mesh>;
namespace Pmp = CGAL::Polygon_mesh_processing;

int main(int argc, char** argv) {
    std::vector<Kernel::Point_3> points;
    std::vector<std::vector<std::size_t>> faces;
    if (argc != 3 || !CGAL::IO::read_polygon_soup(argv[1], points, faces)) {
        std::cerr << "usage: mean_curvature IN.off OUT.txt (a closed mesh of triangles)\n";
        return 1;
    }
    Pmp::orient_polygon_soup(points, faces);
    Mesh mesh;
    Pmp::polygon_soup_to_polygon_mesh(points, faces, mesh);
    Pmp::keep_largest_connected_components(mesh, 1);
    mesh.collect_garbage();
    Skeletonization::Skeleton skeleton;
    CGAL::extract_mean_curvature_flow_skeleton(mesh, skeleton);
    std::ofstream out(argv[2]);
    for (auto vertex : CGAL::make_range(vertices(skeleton))) out << "v " << skeleton[vertex].point << "\n";
    for (auto edge : CGAL::make_range(edges(skeleton)))
        out << "e " << source(edge, skeleton) << " " << target(edge, skeleton) << "\n";
    return out ? 0 : 1;
}
