!> Forces of steep laws (viscovib_steep_laws) at the nodes of a collocation step.
!!
!! The rate of law l at node i is linear in the forces of all steep laws at all nodes,
!!
!!   v_li = b_li + sum_mj G_limj f_mj,   v_li = rate(w_li),   f_li = force(w_li),
!!
!! with b the rates without these forces. Newton's method solves for w. The rate and the force
!! increase with w, and dampers do not increase rates, so that w is bounded. A law whose gains are
!! all 0 has the rate 0, between two sticking masses.
module viscovib_steep_forces
  use viscovib_dense, only: factorize, solve
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_steep_laws, only: rate_of_root, root_of_rate
  implicit none
  private

  public :: solve_steep

  !> Iterations: for an exponent of 0.1 each reduces w by 10 % if it is too large.
  integer, parameter :: most = 200
  !> Relative change of w that counts as converged; largest rate relative to b.
  real(wp), parameter :: solved = 8.0_wp*epsilon(1.0_wp), largest = 10.0_wp

contains

  subroutine solve_steep(system, gains, rates, q, v, roots, forces, made)
    class(driven_system_type), intent(in) :: system
    !> G, shape (s, n_steep, s, n_steep); b, shape (s, n_steep).
    real(wp), intent(in) :: gains(:, :, :, :), rates(:, :)
    !> States at the nodes for the other arguments of laws, shape (s, n_dof).
    real(wp), intent(in) :: q(:, :), v(:, :)
    !> w, on entry a start; f. Shape (s, n_steep).
    real(wp), intent(inout) :: roots(:, :)
    real(wp), intent(out) :: forces(:, :)
    logical, intent(out) :: made
    real(wp) :: matrix(size(rates), size(rates)), g(size(rates), size(rates))
    real(wp) :: residual(size(rates)), change, before, bound
    real(wp), dimension(size(rates, 1), size(rates, 2)) :: slopes, at_rest
    integer :: pivots(size(rates)), i, j, k, l, s
    logical :: singular, still(size(rates, 2))

    s = size(rates, 1)
    g = reshape(gains, shape(g))
    do l = 1, size(rates, 2)
      still(l) = all(abs(gains(:, :, :, l)) <= 0.0_wp)
      if (still(l)) roots(:, l) = 0.0_wp
    end do
    made = .false.
    before = huge(1.0_wp)
    at_rest = 0.0_wp
    call evaluate(at_rest)
    bound = largest*maxval(abs(reshape(rates, shape(residual)) &
                               + matmul(g, reshape(forces, shape(residual)))))
    do k = 1, most
      do l = 1, size(rates, 2)
        associate (a => system%steep(l)%exponent)
          roots(:, l) = sign(min(abs(roots(:, l)), root_of_rate(bound, a)), roots(:, l))
        end associate
      end do
      call evaluate(roots)
      residual = reshape(rates, shape(residual)) + matmul(g, reshape(forces, shape(residual)))
      do l = 1, size(rates, 2)
        associate (a => system%steep(l)%exponent)
          do i = 1, s
            j = (l - 1)*s + i
            matrix(:, j) = -g(:, j)*slopes(i, l)
            matrix(j, j) = matrix(j, j) + abs(roots(i, l))**(1.0_wp/a - 1.0_wp)/a
            residual(j) = residual(j) - rate_of_root(roots(i, l), a)
            if (.not. still(l)) cycle
            matrix(:, j) = 0.0_wp
            matrix(j, j) = 1.0_wp
            residual(j) = 0.0_wp
          end do
        end associate
      end do
      if (.not. all(abs(residual) <= huge(1.0_wp))) return
      if (.not. all(abs(matrix) <= huge(1.0_wp))) return
      call factorize(size(residual), matrix, pivots, singular)
      if (singular) return
      call solve(size(residual), matrix, pivots, residual)
      change = maxval(abs(residual))
      made = change <= solved*maxval(abs(roots)) .or. .not. change > 0.0_wp
      ! The next correction of a converging iteration is rounding.
      made = made .or. (change <= sqrt(solved)*maxval(abs(roots)) .and. change >= before)
      if (made) return
      roots = roots + reshape(residual, shape(roots))
      before = change
    end do

  contains

    !> Forces and their slopes.
    subroutine evaluate(w)
      real(wp), intent(in) :: w(:, :)
      integer :: m
      do m = 1, size(rates, 2)
        call system%steep_forces(m, q, v, w(:, m), forces(:, m), slopes(:, m))
      end do
    end subroutine evaluate

  end subroutine solve_steep

end module viscovib_steep_forces
