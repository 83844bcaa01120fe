!> One step of a stiff motion by Radau collocation with five nodes (order 9, L-stable), for systems
!! with derivatives.
!!
!! The accelerations F_i at the nodes c_i, the last of which is the end of the step, solve
!!
!!   F_i = a(q + c_i h v + h^2 sum_j B_ij F_j, v + h sum_j A_ij F_j, t + c_i h),  B = A A,
!!
!! by Newton's method with the derivatives at every node.
!!
!! Source: Hairer, Wanner, Solving Ordinary Differential Equations II, IV.5 and IV.8.
module viscovib_stiff_step
  use viscovib_dense, only: factorize, solve
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_phases, only: split_phase, turn_phase
  use viscovib_quadrature, only: gauss_nodes, lagrange, lagrange_factors
  implicit none
  private

  public :: stiff_step, fastest_damping

  integer, parameter, public :: n_nodes = 5
  !> Zeros of P_5 - P_4 on [0, 1].
  real(wp), parameter, public :: radau_nodes(n_nodes) = &
    [0.05710419611451768219312_wp, 0.27684301363812382768005_wp, 0.58359043236891682005670_wp, &
     0.86024013565621944784791_wp, 1.0_wp]
  integer, parameter :: max_iterations = 12
  !> Relative change of the accelerations after which the next one is rounding; the same for
  !! a change that no longer decreases.
  real(wp), parameter :: solved = 1.0e-8_wp, all_but_solved = 1.0e-6_wp

contains

  !> The largest decay rate of a velocity due to the coordinate's own damping.
  real(wp) function fastest_damping(system, lane, q, v) result(fastest)
    class(differentiable_system_type), intent(in) :: system
    !> Lane of the block whose parameters are used.
    integer, intent(in) :: lane
    real(wp), intent(in) :: q(:), v(:)
    real(wp) :: by_q(size(q), size(q)), by_v(size(q), size(q)), a(size(q))
    integer :: i
    call slopes(system, lane, q, v, spread(0.0_wp, 1, size(system%drives)), a, by_q, by_v)
    fastest = 0.0_wp
    do i = 1, size(q)
      fastest = max(fastest, -by_v(i, i))
    end do
  end function fastest_damping

  !> A step of length h.
  subroutine stiff_step(system, lane, frequencies, start, h, q, v, q_nodes, v_nodes, made)
    class(differentiable_system_type), intent(in) :: system
    !> Lane of the block whose parameters are used; its load frequencies.
    integer, intent(in) :: lane
    real(wp), intent(in) :: frequencies(:), start, h, q(:), v(:)
    !> States at the nodes, the last at the end, shape (n_nodes, n_dof).
    real(wp), intent(out) :: q_nodes(:, :), v_nodes(:, :)
    logical, intent(out) :: made
    real(wp) :: a(n_nodes, n_nodes), b(n_nodes, n_nodes), f(size(q), n_nodes), x(size(q)*n_nodes)
    real(wp) :: matrix(size(q)*n_nodes, size(q)*n_nodes), drive(size(frequencies), n_nodes)
    real(wp) :: change, before
    integer :: pivots(size(q)*n_nodes), i, k
    logical :: singular

    call coefficients(a)
    b = matmul(a, a)
    call drives_at(system, frequencies, start, h, drive)
    f = 0.0_wp
    before = huge(1.0_wp)
    made = .false.
    do k = 1, max_iterations
      do i = 1, n_nodes
        q_nodes(i, :) = q + h*(radau_nodes(i)*v + h*matmul(f, b(i, :)))
        v_nodes(i, :) = v + h*matmul(f, a(i, :))
      end do
      if (made) exit
      call newton_equations(system, lane, h, a, b, drive, q_nodes, v_nodes, f, x, matrix)
      if (.not. (all(abs(x) <= huge(1.0_wp)) .and. all(abs(matrix) <= huge(1.0_wp)))) return
      call factorize(size(x), matrix, pivots, singular)
      if (singular) return
      call solve(size(x), matrix, pivots, x)
      if (.not. all(abs(x) <= huge(1.0_wp))) return
      f = f + reshape(x, shape(f))
      change = maxval(abs(x))/max(maxval(abs(f)), tiny(1.0_wp))
      made = change <= solved .or. (change <= all_but_solved .and. change >= 0.5_wp*before)
      before = change
    end do
  end subroutine stiff_step

  !> Newton's equations for the change of the accelerations: residual and its derivatives.
  subroutine newton_equations(system, lane, h, a, b, drive, q_nodes, v_nodes, f, lack, matrix)
    class(differentiable_system_type), intent(in) :: system
    integer, intent(in) :: lane
    real(wp), intent(in) :: h, a(:, :), b(:, :), drive(:, :), q_nodes(:, :), v_nodes(:, :), f(:, :)
    real(wp), intent(out) :: lack(:), matrix(:, :)
    real(wp) :: by_q(size(f, 1), size(f, 1)), by_v(size(f, 1), size(f, 1)), there(size(f, 1))
    integer :: i, j, n, d

    n = size(f, 1)
    do i = 1, n_nodes
      call slopes(system, lane, q_nodes(i, :), v_nodes(i, :), drive(:, i), there, by_q, by_v)
      associate (first => n*(i - 1))
        lack(first + 1:first + n) = there - f(:, i)
        do j = 1, n_nodes
          matrix(first + 1:first + n, n*(j - 1) + 1:n*j) = -h*(h*b(i, j)*by_q + a(i, j)*by_v)
        end do
        do d = first + 1, first + n
          matrix(d, d) = matrix(d, d) + 1.0_wp
        end do
      end associate
    end do
  end subroutine newton_equations

  !> Accelerations at a state and their derivatives, one column per direction.
  subroutine slopes(system, lane, q, v, drive, a, by_q, by_v)
    class(differentiable_system_type), intent(in) :: system
    integer, intent(in) :: lane
    real(wp), intent(in) :: q(:), v(:), drive(:)
    real(wp), intent(out) :: a(:), by_q(:, :), by_v(:, :)
    real(wp), dimension(n_lanes, size(q)) :: some_q, some_v, direction, none, there, change
    real(wp) :: drives(n_lanes, size(drive))
    integer :: d

    some_q = spread(q, 1, n_lanes)
    some_v = spread(v, 1, n_lanes)
    drives = spread(drive, 1, n_lanes)
    none = 0.0_wp
    do d = 1, size(q)
      direction = 0.0_wp
      direction(:, d) = 1.0_wp
      call system%tangent(some_q, some_v, drives, direction, none, there, change)
      by_q(:, d) = change(lane, :)
      call system%tangent(some_q, some_v, drives, none, direction, there, change)
      by_v(:, d) = change(lane, :)
    end do
    a = there(lane, :)
  end subroutine slopes

  !> Loads at the nodes, shape (n_drives, n_nodes).
  subroutine drives_at(system, frequencies, start, h, drive)
    class(differentiable_system_type), intent(in) :: system
    real(wp), intent(in) :: frequencies(:), start, h
    real(wp), intent(out) :: drive(:, :)
    real(wp) :: high(size(frequencies)), low(size(frequencies))
    integer :: i
    call split_phase(frequencies, start, high, low)
    if (allocated(system%quarters)) call turn_phase(high, low, system%quarters)
    do i = 1, n_nodes
      drive(:, i) = cos(high + (low + frequencies*(h*radau_nodes(i))))
    end do
  end subroutine drives_at

  !> A_ij, the integral from 0 to c_i of the polynomial that is 1 at c_j.
  pure subroutine coefficients(a)
    real(wp), intent(out) :: a(n_nodes, n_nodes)
    real(wp) :: x(n_nodes), w(n_nodes), factors(n_nodes)
    integer :: i, k
    call gauss_nodes(n_nodes, x, w)
    factors = lagrange_factors(radau_nodes)
    a = 0.0_wp
    do i = 1, n_nodes
      do k = 1, n_nodes
        a(i, :) = a(i, :) &
                  + radau_nodes(i)*w(k)*lagrange(radau_nodes, factors, radau_nodes(i)*x(k))
      end do
    end do
  end subroutine coefficients

end module viscovib_stiff_step
