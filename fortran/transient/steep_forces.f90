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
    real(wp), dimension(size(rates, 1), size(rates, 2)) :: slopes, at_rest, residual
    real(wp) :: change, before, bound
    integer :: free(size(rates, 2)), k, l
    logical :: still(size(rates, 2))

    made = .false.
    before = huge(1.0_wp)
    free = 0
    do l = 1, size(rates, 2)
      still(l) = all(abs(gains(:, :, :, l)) <= 0.0_wp)
      if (system%steep(l)%leader == l .and. .not. still(l)) free(l) = maxval(free) + 1
    end do
    at_rest = 0.0_wp
    call evaluate(at_rest)
    bound = largest*maxval(abs(rates + moved_by(forces)))
    do k = 1, most
      do l = 1, size(rates, 2)
        associate (a => system%steep(l)%exponent)
          roots(:, l) = sign(min(abs(roots(:, l)), root_of_rate(bound, a)), roots(:, l))
          if (still(l)) roots(:, l) = 0.0_wp
        end associate
      end do
      call follow_leaders()
      call evaluate(roots)
      residual = rates + moved_by(forces)
      call correct(system, gains, roots, slopes, free, residual, made)
      if (.not. made) return
      change = maxval(abs(residual))
      made = change <= solved*maxval(abs(roots)) .or. .not. change > 0.0_wp
      ! The next correction of a converging iteration is rounding.
      made = made .or. (change <= sqrt(solved)*maxval(abs(roots)) .and. change >= before)
      if (made) return
      roots = roots + residual
      before = change
    end do

  contains

    !> Laws with a common rate have the root of their leader.
    subroutine follow_leaders()
      integer :: m
      do m = 1, size(rates, 2)
        associate (law => system%steep(m))
          if (law%leader == m) cycle
          roots(:, m) = root_of_rate(law%factor*rate_of_root( &
                                     roots(:, law%leader), system%steep(law%leader)%exponent), &
                                     law%exponent)
        end associate
      end do
    end subroutine follow_leaders

    !> Rates by forces.
    function moved_by(f) result(moved)
      real(wp), intent(in) :: f(:, :)
      real(wp) :: moved(size(f, 1), size(f, 2))
      moved = reshape(matmul(reshape(gains, [size(f), size(f)]), reshape(f, [size(f)])), shape(f))
    end function moved_by

    !> Forces and their slopes.
    subroutine evaluate(w)
      real(wp), intent(in) :: w(:, :)
      integer :: m
      do m = 1, size(rates, 2)
        call system%steep_forces(m, q, v, w(:, m), forces(:, m), slopes(:, m))
      end do
    end subroutine evaluate

  end subroutine solve_steep

  !> Replace the rates by Newton's corrections of the roots of the leaders; 0 for other laws.
  subroutine correct(system, gains, roots, slopes, free, residual, made)
    class(driven_system_type), intent(in) :: system
    !> As of `solve_steep`.
    real(wp), intent(in) :: gains(:, :, :, :), roots(:, :)
    !> Derivatives of the forces by the roots.
    real(wp), intent(in) :: slopes(:, :)
    !> Numbers of the leaders whose rates do not stay 0; of other laws 0.
    integer, intent(in) :: free(:)
    !> b + G f on entry.
    real(wp), intent(inout) :: residual(:, :)
    logical, intent(out) :: made
    real(wp) :: right(maxval(free)*size(roots, 1)), matrix(size(right), size(right))
    real(wp) :: weight(size(roots, 1))
    integer :: pivots(size(right)), i, j, m, u, s
    logical :: singular

    s = size(roots, 1)
    matrix = 0.0_wp
    do m = 1, size(roots, 2)
      associate (law => system%steep(m), leader => system%steep(system%steep(m)%leader))
        u = free(law%leader)
        if (u == 0) cycle
        weight = slopes(:, m)
        if (law%leader /= m) then
          ! w_m = |factor|^a_m |w|^(a_m/a), a <= a_m.
          weight = weight*sign(abs(law%factor)**law%exponent, law%factor) &
                   *(law%exponent/leader%exponent) &
                   *abs(roots(:, law%leader))**(law%exponent/leader%exponent - 1.0_wp)
        end if
        do j = 1, size(roots, 2)
          if (free(j) == 0) cycle
          do i = 1, s
            matrix((free(j) - 1)*s + 1:free(j)*s, (u - 1)*s + i) = &
              matrix((free(j) - 1)*s + 1:free(j)*s, (u - 1)*s + i) - gains(:, j, i, m)*weight(i)
          end do
        end do
        if (law%leader /= m) cycle
        do i = 1, s
          j = (u - 1)*s + i
          matrix(j, j) = matrix(j, j) + abs(roots(i, m))**(1.0_wp/law%exponent - 1.0_wp) &
                         /law%exponent
          right(j) = residual(i, m) - rate_of_root(roots(i, m), law%exponent)
        end do
      end associate
    end do
    residual = 0.0_wp
    made = size(right) == 0
    if (made) return
    if (.not. all(abs(right) <= huge(1.0_wp))) return
    if (.not. all(abs(matrix) <= huge(1.0_wp))) return
    call factorize(size(right), matrix, pivots, singular)
    if (singular) return
    call solve(size(right), matrix, pivots, right)
    do m = 1, size(roots, 2)
      if (free(m) > 0) residual(:, m) = right((free(m) - 1)*s + 1:free(m)*s)
    end do
    made = .true.
  end subroutine correct

end module viscovib_steep_forces
