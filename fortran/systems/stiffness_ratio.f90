!> Warnings about stiffness ratios so large that rounding errors hide the soft springs.
!!
!! A mode of unit modal mass has omega^2 = phi^T K phi. Each entry of K has a rounding error of up
!! to half a unit in its last place. The error of omega^2 is then about
!!
!!   0.3 eps sqrt(sum_ij (phi_i K_ij phi_j)^2),                                             (1)
!!
!! (first-order perturbation of a simple eigenvalue, Wilkinson, The Algebraic Eigenvalue Problem,
!! 1965, chapter 2). The root mean square error of an entry is 0.21 eps times the entry; K_ij and
!! K_ji have the same error.
module viscovib_stiffness_ratio
  use viscovib_damped_modes, only: find_damped_modes
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: show
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: hidden_modes, hidden_poles, hidden_springs

  !> Precision for sums with strong cancellation.
  integer, parameter :: wide = selected_real_kind(18)
  !> Relative error of a matrix entry in (1).
  real(wp), parameter :: off = 0.3_wp*epsilon(1.0_wp)
  !> Largest relative rounding error of omega^2 without a warning, and the relative error above
  !! which a mode may be that of a free body.
  real(wp), parameter :: least = 1.0e-6_wp, free = 0.15_wp
  !> Kinetic energy fraction above which a coordinate participates in a mode; stiffnesses and
  !! asymmetry below these fractions of the largest entry are rounding errors.
  real(wp), parameter :: taking = 1.0e-3_wp, nothing = 1.0e-30_wp, asymmetric = 1.0e-12_wp

contains

  !> Warning about the least accurate real mode; empty if none.
  !!
  !! A mode smaller than its error belongs to a free body, unless the error is large compared with
  !! the softest coordinate that participates in the mode or is connected to one.
  function hidden_modes(squares, shapes, mass, stiffness) result(text)
    !> Shapes (m), (n, m) and (n, n).
    real(wp), intent(in) :: squares(:), shapes(:, :), mass(:, :), stiffness(:, :)
    character(len=:), allocatable :: text
    real(wp), dimension(size(squares)) :: lost
    real(wp) :: found, softest, part, worst, frequency
    logical :: is_free
    integer :: m, at

    text = ''
    lost = off*spread_of(abs(shapes), stiffness, abs(shapes))
    worst = 0.0_wp
    at = 0
    frequency = 0.0_wp
    is_free = .false.
    do m = 1, size(squares)
      if (abs(squares(m))*least >= 10.0_wp*lost(m)) cycle
      ! The eigenvalue solver has errors of the same size; evaluate with the matrix itself.
      found = abs(real(sum(real(shapes(:, m), wide) &
                           *matmul(real(stiffness, wide), real(shapes(:, m), wide))), wp))
      part = lost(m)/max(found, tiny(found)/epsilon(found))
      softest = softest_nearby(shapes(:, m), mass, stiffness)
      if (part <= max(least, worst)) cycle
      if (part >= free .and. lost(m) <= least*softest) cycle
      worst = part
      at = m
      is_free = part >= free .or. .not. abs(squares(m)) > 0.0_wp
      frequency = sqrt(merge(max(found, lost(m)), found, is_free))
    end do
    if (at > 0) text = description('mode '//show(at), frequency, worst, is_free)
  end function hidden_modes

  !> Warning about complex modes, by (1) with left and right vectors and twice the relative error.
  function hidden_poles(poles, left, right, stiffness) result(text)
    !> Shapes (p), (n, p) and (n, n).
    complex(wp), intent(in) :: poles(:), left(:, :), right(:, :)
    real(wp), intent(in) :: stiffness(:, :)
    character(len=:), allocatable :: text
    real(wp) :: lost(size(poles))
    integer :: at

    text = ''
    lost = 2.0_wp*off*spread_of(abs(right), stiffness, abs(left))
    where (abs(poles) > 0.0_wp)
      lost = lost/abs(poles)
    else where
      lost = 0.0_wp
    end where
    at = maxloc(lost, 1)
    if (lost(at) > least) text = description('a mode', abs(poles(at)), lost(at), .false.)
  end function hidden_poles

  !> Warning about a polynomial system, which is solved in its coordinates, without damping.
  function hidden_springs(system) result(text)
    type(polynomial_type), intent(in) :: system
    character(len=:), allocatable :: text
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: stiffness, shapes
    real(wp) :: squares(size(system%mass, 1))
    complex(wp), dimension(size(system%mass, 1), 2*size(system%mass, 1)) :: left, right
    complex(wp) :: poles(2*size(system%mass, 1))
    logical :: found

    text = ''
    if (size(squares) == 1) return
    stiffness = matmul(system%spread, system%gather)
    if (maxval(abs(stiffness - transpose(stiffness))) <= asymmetric*maxval(abs(stiffness))) then
      call find_symmetric_modes(system%mass, stiffness, squares, shapes)
      text = hidden_modes(squares, shapes, system%mass, stiffness)
    else
      call find_damped_modes(system%mass, 0.0_wp*stiffness, stiffness, poles, left, right, found)
      if (found) text = hidden_poles(poles, left, right, stiffness)
    end if
  end function hidden_springs

  !> Square root in (1).
  pure function spread_of(left, stiffness, right) result(root)
    real(wp), intent(in) :: left(:, :), stiffness(:, :), right(:, :)
    real(wp) :: root(size(left, 2)), largest

    root = 0.0_wp
    largest = maxval(abs(stiffness))
    if (.not. largest > 0.0_wp) return
    root = largest*sqrt(sum(left**2*matmul((stiffness/largest)**2, right**2), 1))
  end function spread_of

  !> Smallest k_ii/m_ii of the coordinates that participate in the mode or are connected to one.
  pure real(wp) function softest_nearby(shape, mass, stiffness) result(softest)
    real(wp), intent(in) :: shape(:), mass(:, :), stiffness(:, :)
    logical :: takes(size(shape))
    real(wp) :: largest
    integer :: i

    largest = 0.0_wp
    do i = 1, size(shape)
      largest = max(largest, abs(stiffness(i, i)))
      takes(i) = mass(i, i)*shape(i)**2 > taking
    end do
    softest = huge(softest)
    do i = 1, size(shape)
      if (abs(stiffness(i, i)) <= nothing*largest) cycle
      if (any(takes .and. abs(stiffness(:, i)) > nothing*largest)) then
        softest = min(softest, abs(stiffness(i, i))/mass(i, i))
      end if
    end do
  end function softest_nearby

  function description(name, frequency, lost, is_free) result(text)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: frequency, lost
    logical, intent(in) :: is_free
    character(len=:), allocatable :: text

    if (is_free) then
      text = name//' may be free, or have up to about '//show(frequency)//' rad/s'
    else
      text = name//' has '//show(frequency)//' rad/s, and the square of that is known to about ' &
             //show(lost)//' only'
    end if
    text = 'stiffness: springs are so different that rounding hides the soft ones: '//text &
           //'; stiffer parts may be made rigid, or softer'//new_line('a')
  end function description

end module viscovib_stiffness_ratio
