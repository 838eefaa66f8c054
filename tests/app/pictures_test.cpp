// Colours of costs, text, montages, and which picture files a run gets.
#include "app/pictures.h"

#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "app/heat_map.h"
#include "app/montage.h"

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

gpu::PixelCounts counts(uint32_t box_tests, uint32_t prim_tests) {
  gpu::PixelCounts c{};
  c.node_visits = 1000;  // cost nothing
  c.box_tests = box_tests;
  c.prim_tests = prim_tests;
  return c;
}

TEST(HeatMap, CostIsHalfABoxPlusATriangle) {
  EXPECT_EQ(heat_cost(counts(7, 3)), 6.5f);
  EXPECT_EQ(heat_full_scale("teapot"), 40.0f);
  EXPECT_EQ(heat_full_scale("teapot:12"), 40.0f);
  EXPECT_EQ(heat_full_scale("teapot.ply"), 50.0f);
  EXPECT_EQ(heat_full_scale("dragon"), 50.0f);
}

TEST(HeatMap, PlasmaRunsFromBlueToYellow) {
  EXPECT_EQ(plasma(0.0f), (Rgb{13, 8, 135}));
  EXPECT_EQ(plasma(1.0f), (Rgb{240, 249, 33}));
  EXPECT_EQ(plasma(-3.0f), plasma(0.0f));
  EXPECT_EQ(plasma(9.0f), plasma(1.0f));
  // Between two of the ten stops: halfway between (13, 8, 135) and (70, 3, 159).
  const Rgb middle = plasma(0.5f / 9.0f);
  EXPECT_NEAR(middle.r, 41.5, 0.51);
  EXPECT_NEAR(middle.g, 5.5, 0.51);
  EXPECT_NEAR(middle.b, 147, 0.51);
  // Lightness rises all the way, so that it also reads in grey.
  double before = 0.0;
  for (int i = 0; i <= 100; ++i) {
    const Rgb c = plasma(static_cast<float>(i) / 100.0f);
    const double luma = 0.2126 * c.r + 0.7152 * c.g + 0.0722 * c.b;
    EXPECT_GE(luma, before - 0.6) << i;
    before = luma;
  }
}

TEST(HeatMap, HasAPixelAPixel) {
  const std::vector<gpu::PixelCounts> row{counts(0, 0), counts(20, 10), counts(0, 99)};
  const Image image = heat_map(row, 3, 1, 40.0f);
  EXPECT_EQ(image.at(0, 0), plasma(0.0f));
  EXPECT_EQ(image.at(1, 0), plasma(0.5f));
  EXPECT_EQ(image.at(2, 0), plasma(1.0f));
}

TEST(Montage, ShrinkAverages) {
  Image image(4, 2);
  image.set(0, 0, {200, 0, 0});
  image.set(1, 1, {200, 40, 0});
  const Image small = shrink(image, 2);
  EXPECT_EQ(small.width, 2u);
  EXPECT_EQ(small.height, 1u);
  EXPECT_EQ(small.at(0, 0), (Rgb{100, 10, 0}));
  EXPECT_EQ(small.at(1, 0), (Rgb{}));
  EXPECT_EQ(shrink(image, 4).rgb, image.rgb);
  // 7 wide at most 3: a third of it, 2 wide; the rest is cut off.
  EXPECT_EQ(shrink(Image(7, 1, {9, 9, 9}), 3).rgb, Image(2, 1, {9, 9, 9}).rgb);
}

TEST(Montage, EveryCharacterLooksDifferent) {
  std::set<std::string> seen;
  const std::string all = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_ ";
  for (const char c : all) {
    Image image(6, 8, {255, 255, 255});
    draw_text(image, 0, 0, std::string(1, c), 1);
    seen.emplace(image.rgb.begin(), image.rgb.end());
  }
  EXPECT_EQ(seen.size(), all.size());
  Image image(3, 3, {255, 255, 255});
  draw_text(image, 0, 0, "WWWW", 5);  // far too large: drawn as far as there is room
}

TEST(Montage, PutsTilesWhereTheyBelong) {
  const Rgb red{255, 0, 0}, green{0, 255, 0}, blue{0, 0, 255};
  const Image image = montage(
      std::vector<Tile>{
          {"A", Image(20, 10, red)}, {"B", Image(20, 10, green)}, {"C", Image(20, 10, blue)}},
      2, std::nullopt);
  EXPECT_EQ(image.width, 2u * 20 + 3 * 4);
  const uint32_t label = 7 + 2 * 4;
  EXPECT_EQ(image.height, 2 * (label + 10) + 4);
  EXPECT_EQ(image.at(4, label), red);
  EXPECT_EQ(image.at(23, label + 9), red);
  EXPECT_EQ(image.at(28, label), green);
  EXPECT_EQ(image.at(4, 2 * label + 10), blue);
  EXPECT_EQ(image.at(28, 2 * label + 10), (Rgb{255, 255, 255}));
  EXPECT_TRUE(montage({}, 2, 40).rgb.empty());
}

TEST(Montage, BarHasTheColoursOfTheScale) {
  const Image image = montage(std::vector<Tile>{{"A", Image(200, 10)}}, 2, 40);
  const uint32_t y = image.height - 4 - 7 - 4 - 3;  // inside the bar, above its numbers
  EXPECT_EQ(image.at(4, y), plasma(0.0f));
  EXPECT_EQ(image.at(104, y), plasma(0.5f));
}

class PicturesTest : public testing::Test {
 protected:
  PicturesTest() {
    std::string pattern = (fs::temp_directory_path() / "energyprof_pictures_XXXXXX").string();
    dir_ = mkdtemp(pattern.data());
  }
  ~PicturesTest() override { fs::remove_all(dir_); }
  [[nodiscard]] std::set<std::string> files() const {
    std::set<std::string> names;
    for (const auto& entry : fs::directory_iterator(dir_))
      names.insert(entry.path().filename().string());
    return names;
  }

  fs::path dir_;
};

TEST_F(PicturesTest, AreNamedByModelViewAndAlgorithm) {
  Pictures pictures(dir_);
  const Image image(32, 18);
  for (int64_t view = 0; view < 2; ++view) {
    EXPECT_FALSE(pictures.has_reference("teapot:2", view));
    pictures.add_reference("teapot:2", view, image);
    EXPECT_TRUE(pictures.has_reference("teapot:2", view));
    pictures.add_heat_map("teapot:2", view, "BVH_STACKLESS_DF", image);
    pictures.add_heat_map("teapot:2", view, "GRID", image);
    pictures.finish_view("teapot:2", view);
  }
  pictures.finish();
  EXPECT_EQ(files(), (std::set<std::string>{
                         "teapot_2_view0_reference.png", "teapot_2_view1_reference.png",
                         "teapot_2_view0_BVH_STACKLESS_DF_heat.png",
                         "teapot_2_view1_BVH_STACKLESS_DF_heat.png", "teapot_2_view0_GRID_heat.png",
                         "teapot_2_view1_GRID_heat.png", "teapot_2_view0_montage.png",
                         "teapot_2_view1_montage.png", "teapot_2_BVH_STACKLESS_DF_views.png"}));
}

TEST_F(PicturesTest, WithoutHeatMapsThereIsNoMontage) {
  Pictures pictures(dir_);
  pictures.add_reference("m", 0, Image(8, 8));
  pictures.finish_view("m", 0);
  pictures.finish_view("m", 1);
  pictures.finish();
  EXPECT_EQ(files(), std::set<std::string>{"m_view0_reference.png"});
}

TEST_F(PicturesTest, ReferenceHalvesTheLightWithEachHit) {
  ReferenceImage reference(3, 1);
  const gpu::PixelHits miss{0, 0, 0xffffffffu, 0};
  const gpu::PixelHits hit{1, 0, 0, 0};
  const gpu::PixelHits both{1, 0, 2, 0};
  reference.add(std::vector{miss, hit, both});
  reference.add(std::vector{hit, hit, hit});
  const Image image = reference.image();
  EXPECT_EQ(image.at(0, 0).r, 191);  // (1 + 1/2) / 2
  EXPECT_EQ(image.at(1, 0).g, 128);
  EXPECT_EQ(image.at(2, 0).b, 96);  // (1/4 + 1/2) / 2
}

TEST_F(PicturesTest, SayWhatCouldNotBeWritten) {
  Pictures pictures(dir_ / "absent");
  try {
    pictures.add_reference("m", 0, Image(2, 2));
    FAIL() << "was written";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("absent/m_view0_reference.png"), std::string::npos);
  }
}

}  // namespace
}  // namespace energyprof::app
